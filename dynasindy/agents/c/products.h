/* Products of matrices: out[m] = sum_k a(m, k) x[k] for rows m of a factor and panels x of P columns. They are taken in
   float32, or by a processor that reads factors in bfloat16 and adds in float32: by its tiles (Intel AMX), or, where it
   has none, by its vectors (AVX-512 BF16, which processors of AMD have, too).

   For that a number is rounded to one bfloat16, or held as the sum of two, of whose four products the largest three are
   taken: what is left out is some 2^-16 of it. Blocks of 32 rows are read 32 numbers at a time, in pairs of halves of a
   word, as _tile_dpbf16ps and _mm512_dpbf16_ps take them. A tile holds 16 rows of 16 such words. */
#include <stdint.h>
#include <string.h>

#if defined(__AVX512F__)
#define LANES 16
#elif defined(__AVX__)
#define LANES 8
#else
#define LANES 4
#endif
#define INLINE static inline __attribute__((always_inline))
enum { P = 2 * LANES, AT_ONCE = 8 }; /* AT_ONCE * 2 sums fit into the registers */
typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

/* Element (m, k) of a matrix lies at a[m * row + k * col], where k runs over `outer` blocks of `inner`. */
typedef struct {
    const float *a;
    long row, col, jump; /* from one m to the next, from one k to the next, from one block to the next */
    int outer, inner;
} Factor;

/* Two factors in bfloat16, and room for them. */
typedef struct {
    int parts;             /* bfloat16 for each number; 0 where products are taken in float32 */
    int rows, steps;       /* of the left factor */
    int used;              /* whether this product is taken in bfloat16 */
    uint32_t *left, *right;
} Halves;

enum { SIDE = 32, TILE = 256, LEAST = 8 }; /* rows of a block; words of a tile; numbers of a sum that is worth it */

static int steps_of(Factor f) { return f.outer * ((f.inner + SIDE - 1) / SIDE); }

/* Words of room for a factor of so many rows. */
static long words_of(Factor f, int rows, int parts) { return (rows + SIDE - 1L) / SIDE * steps_of(f) * 2 * parts * TILE; }

/* ---- in float32 ---- */

INLINE void tile(int count, int wide, Factor f, const float *x, float *out)
{
    vec sum[AT_ONCE][2];
#pragma GCC unroll 8
    for (int m = 0; m < count; m++)
#pragma GCC unroll 2
        for (int v = 0; v < wide; v++)
            sum[m][v] = (vec){0};
    for (int block = 0; block < f.outer; block++) {
        const float *a = f.a + block * f.jump;
        for (int k = 0; k < f.inner; k++, a += f.col, x += P) {
            vec right[2];
#pragma GCC unroll 2
            for (int v = 0; v < wide; v++)
                right[v] = *(const vec *)(x + v * LANES);
#pragma GCC unroll 8
            for (int m = 0; m < count; m++)
#pragma GCC unroll 2
                for (int v = 0; v < wide; v++)
                    sum[m][v] += a[m * f.row] * right[v];
        }
    }
#pragma GCC unroll 8
    for (int m = 0; m < count; m++)
#pragma GCC unroll 2
        for (int v = 0; v < wide; v++)
            *(vec *)(out + m * P + v * LANES) = sum[m][v];
}

/* As many of the next m, from `left`, as one tile takes. */
INLINE int product(int left, int wide, Factor f, const float *x, float *out)
{
    if (left >= 8) return tile(8, wide, f, x, out), 8;
    if (left >= 4) return tile(4, wide, f, x, out), 4;
    if (left >= 2) return tile(2, wide, f, x, out), 2;
    return tile(1, wide, f, x, out), 1;
}

/* ---- in bfloat16 ---- */

#if defined(__AVX512BF16__) && defined(__AVX512BW__)
#include <immintrin.h>

/* What rounding to bfloat16 leaves of each number. */
static __m512 left_over(__m512 x)
{
    __m256i high = (__m256i)_mm512_cvtneps_pbh(x);
    return _mm512_sub_ps(x, _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(high), 16)));
}

static __m512 part_of(int part, const float *from)
{
    __m512 x = _mm512_loadu_ps(from);
    return part ? left_over(x) : x;
}

/* Rows and columns of a tile exchanged: where row i and row i + 8 are dealt like cards four times over, each word ends
   where rows and columns are exchanged. */
static void exchange(__m512i *rows)
{
    const __m512i low = _mm512_set_epi32(23, 7, 22, 6, 21, 5, 20, 4, 19, 3, 18, 2, 17, 1, 16, 0);
    const __m512i high = _mm512_set_epi32(31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8);
    __m512i dealt[16];
    for (int round = 0; round < 4; round++) {
        for (int i = 0; i < 8; i++) {
            dealt[2 * i] = _mm512_permutex2var_epi32(rows[i], low, rows[i + 8]);
            dealt[2 * i + 1] = _mm512_permutex2var_epi32(rows[i], high, rows[i + 8]);
        }
        for (int i = 0; i < 16; i++)
            rows[i] = dealt[i];
    }
}

/* A tile of 16 rows by 32 columns: a row of pairs of columns for each row, or, `by_pairs`, for each pair of columns. One of
   `row` and `col` is 1. */
static void round_tile(const float *a, long row, long col, int part, int by_pairs, uint32_t *to)
{
    const __m512i mixed = _mm512_set_epi16(31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8, 23, 7, 22, 6,
                                           21, 5, 20, 4, 19, 3, 18, 2, 17, 1, 16, 0);
    __m512i rows[16];
    for (int i = 0; i < 16; i++)
        if (col == 1)
            rows[i] = (__m512i)_mm512_cvtne2ps_pbh(part_of(part, a + i * row + 16), part_of(part, a + i * row));
        else
            rows[i] = _mm512_permutexvar_epi16(mixed, (__m512i)_mm512_cvtne2ps_pbh(
                part_of(part, a + (2 * i + 1) * col), part_of(part, a + 2 * i * col)));
    if (by_pairs == (col == 1)) exchange(rows);
    for (int i = 0; i < 16; i++)
        _mm512_storeu_si512(to + 16 * i, rows[i]);
}

/* The first `count` rows of a factor, filled up with zeros to 32, for all steps: two tiles for each step and part. */
static void round_rows(Factor f, int count, int parts, int by_pairs, uint32_t *to)
{
    float rest[16 * SIDE];
    for (int block = 0; block < f.outer; block++)
        for (int k = 0; k < f.inner; k += SIDE)
            for (int part = 0; part < parts; part++)
                for (int m = 0; m < SIDE; m += 16, to += TILE) {
                    int rows = count - m < 16 ? count - m : 16, columns = f.inner - k < SIDE ? f.inner - k : SIDE;
                    const float *a = f.a + block * f.jump + m * f.row + k * f.col;
                    if (rows == 16 && columns == SIDE) {
                        round_tile(a, f.row, f.col, part, by_pairs, to);
                        continue;
                    }
                    long row = f.col == 1 ? SIDE : 1, col = f.col == 1 ? 1 : 16;
                    for (int i = 0; i < 16 * SIDE; i++)
                        rest[i] = 0;
                    for (int i = 0; i < rows; i++)
                        for (int j = 0; j < columns; j++)
                            rest[i * row + j * col] = a[i * f.row + j * f.col];
                    round_tile(rest, row, col, part, by_pairs, to);
                }
}

static void enter_left(Halves *halves, Factor f, int rows)
{
    halves->rows = rows, halves->steps = steps_of(f);
    uint32_t *to = halves->left;
    for (int m = 0; m < rows; m += SIDE, f.a += SIDE * f.row, to += words_of(f, SIDE, halves->parts))
        round_rows(f, rows - m, halves->parts, 0, to);
}

static void enter_right(Halves *halves, Factor f, int rows) { round_rows(f, rows, halves->parts, 1, halves->right); }

static int allowed; /* whether the system lets this process use tiles */

#if defined(__AMX_TILE__) && defined(__AMX_BF16__) && defined(__linux__)
INLINE void load_left(const uint32_t *from)
{
    _tile_loadd(4, from, 64);
    _tile_loadd(5, from + TILE, 64);
}

INLINE void load_right(const uint32_t *from)
{
    _tile_loadd(6, from, 64);
    _tile_loadd(7, from + TILE, 64);
}

INLINE void add_products(void)
{
    _tile_dpbf16ps(0, 4, 6);
    _tile_dpbf16ps(1, 4, 7);
    _tile_dpbf16ps(2, 5, 6);
    _tile_dpbf16ps(3, 5, 7);
}

/* What lies there is as it was written: compilers do not know how much the instructions of tiles read and write. */
INLINE void settle(const void *what) { __asm__ volatile("" : : "r"(what) : "memory"); }

/* The sums of a block of 32 rows and 32 columns. */
static void tile_sums(const Halves *halves, const uint32_t *left, const uint32_t *right, float *sums)
{
    const int size = 2 * halves->parts * TILE;
    settle(sums);
    _tile_zero(0);
    _tile_zero(1);
    _tile_zero(2);
    _tile_zero(3);
    for (int step = 0; step < halves->steps; step++, left += size, right += size) {
        load_left(left);
        load_right(right);
        add_products();
        if (halves->parts == 1) continue;
        load_right(right + 2 * TILE);
        add_products();
        load_left(left + 2 * TILE);
        load_right(right);
        add_products();
    }
    _tile_stored(0, sums, 4 * SIDE);
    _tile_stored(1, sums + 16, 4 * SIDE);
    _tile_stored(2, sums + 16 * SIDE, 4 * SIDE);
    _tile_stored(3, sums + 16 * SIDE + 16, 4 * SIDE);
    settle(sums);
}

/* Sets the tiles of this thread to 16 rows of 64 bytes, until `release_tiles`. */
static void set_tiles(void)
{
    if (!allowed) return;
    struct {
        uint8_t palette, start, unused[14];
        uint16_t bytes[16];
        uint8_t rows[16];
    } shape = {.palette = 1};
    for (int i = 0; i < 8; i++)
        shape.bytes[i] = 64, shape.rows[i] = 16;
    settle(&shape);
    _tile_loadconfig(&shape);
}

static void release_tiles(void)
{
    if (allowed) _tile_release();
}

static int ask_for_tiles(void)
{
    long syscall(long number, ...);
    return syscall(158, 0x1023, 18) == 0; /* arch_prctl(ARCH_REQ_XCOMP_PERM, XFEATURE_XTILE_DATA) */
}
#else
static void tile_sums(const Halves *halves, const uint32_t *left, const uint32_t *right, float *sums)
{
    (void)halves, (void)left, (void)right, (void)sums;
}
static void set_tiles(void) {}
static void release_tiles(void) {}
static int ask_for_tiles(void) { return 0; }
#endif

enum { ROWS = 8 }; /* rows of sums that fit into the registers, two vectors each */

/* Add the products of 8 rows of a tile, from row i on, with 32 columns: a pair of numbers of each at a time. */
INLINE void add_pairs(__m512 sum[ROWS][2], int i, const uint32_t *left, const uint32_t *right)
{
#pragma GCC unroll 4
    for (int k = 0; k < 16; k++) {
        const __m512bh first = (__m512bh)_mm512_loadu_si512(right + 16 * k);
        const __m512bh second = (__m512bh)_mm512_loadu_si512(right + TILE + 16 * k);
#pragma GCC unroll 8
        for (int m = 0; m < ROWS; m++) {
            const __m512bh row = (__m512bh)_mm512_set1_epi32((int)left[16 * (i + m) + k]);
            sum[m][0] = _mm512_dpbf16_ps(sum[m][0], row, first);
            sum[m][1] = _mm512_dpbf16_ps(sum[m][1], row, second);
        }
    }
}

/* The sums of a block of 32 rows and 32 columns. */
static void vector_sums(const Halves *halves, const uint32_t *left, const uint32_t *right, float *sums)
{
    const int size = 2 * halves->parts * TILE;
    for (int m = 0; m < SIDE; m += ROWS) {
        const uint32_t *a = left + m / 16 * TILE, *b = right;
        __m512 sum[ROWS][2];
#pragma GCC unroll 8
        for (int i = 0; i < ROWS; i++)
            sum[i][0] = sum[i][1] = _mm512_setzero_ps();
        for (int step = 0; step < halves->steps; step++, a += size, b += size) {
            add_pairs(sum, m % 16, a, b);
            if (halves->parts == 1) continue;
            add_pairs(sum, m % 16, a, b + 2 * TILE);
            add_pairs(sum, m % 16, a + 2 * TILE, b);
        }
#pragma GCC unroll 8
        for (int i = 0; i < ROWS; i++)
#pragma GCC unroll 2
            for (int v = 0; v < 2; v++)
                _mm512_storeu_ps(sums + (m + i) * SIDE + 16 * v, sum[i][v]);
    }
}

/* The next rows of the product from row m, a multiple of 32: out[i * 32 + j]. Returns how many. */
static int multiply(const Halves *halves, int m, float *out)
{
    const int count = halves->rows - m < SIDE ? halves->rows - m : SIDE;
    const uint32_t *left = halves->left + (long)(m / SIDE) * halves->steps * 2 * halves->parts * TILE;
    float some[SIDE * SIDE], *sums = count == SIDE ? out : some;
    (allowed ? tile_sums : vector_sums)(halves, left, halves->right, sums);
    if (count < SIDE) memcpy(out, some, sizeof(float) * SIDE * (unsigned)count);
    return count;
}

/* Of how many bfloat16 for each number products are best taken, if as many as `parts` are wanted; 0 for float32. Asks the
   system for tiles, if there are any. By vectors, two parts would take longer than float32. */
int halves(int parts)
{
    allowed = ask_for_tiles();
    return allowed || parts == 1 ? parts : 0;
}
#else
int halves(int parts) { return (void)parts, 0; }
static void set_tiles(void) {}
static void release_tiles(void) {}
static void enter_left(Halves *halves, Factor f, int rows) { (void)halves, (void)f, (void)rows; }
static void enter_right(Halves *halves, Factor f, int rows) { (void)halves, (void)f, (void)rows; }
static int multiply(const Halves *halves, int m, float *out) { return (void)halves, (void)m, (void)out, 0; }
#endif

/* ---- either ---- */

/* A product begins: its left factor of so many rows, for a right one of so many columns. */
static void begin(Halves *halves, Factor left, int rows, int columns)
{
    halves->used = halves->parts && rows >= LEAST && columns >= LEAST && left.outer * left.inner >= LEAST;
    if (halves->used) enter_left(halves, left, rows);
}

/* The right factor's next P columns, or what there is of them; a row of `right` is a column here. */
static void go_on(Halves *halves, Factor right, int columns)
{
    if (halves->used) enter_right(halves, right, columns);
}

/* The next rows from row m of the product with panel x: out[i * P + j] for up to 32 rows i. Returns how many. `left`
   begins at row m. */
INLINE int rows_of(const Halves *halves, int m, int count, int wide, Factor left, const float *x, float *out)
{
    return halves->used ? multiply(halves, m, out) : product(count - m, wide, left, x, out);
}
