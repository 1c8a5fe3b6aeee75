
/* Solve A X = B by Gaussian elimination with row exchanges: A (n, n) is lost, B (n, m) becomes X. */
static int solve(double *a, double *b, int n, int m)
{
    int c, i, j;
    for (c = 0; c < n; c++) {
        int best = c;
        for (i = c + 1; i < n; i++)
            if (fabs(a[i * n + c]) > fabs(a[best * n + c]))
                best = i;
        if (!(fabs(a[best * n + c]) > 0.0))
            return 0;
        for (j = 0; best != c && j < n; j++) {
            const double kept = a[c * n + j];
            a[c * n + j] = a[best * n + j];
            a[best * n + j] = kept;
        }
        for (j = 0; best != c && j < m; j++) {
            const double kept = b[c * m + j];
            b[c * m + j] = b[best * m + j];
            b[best * m + j] = kept;
        }
        for (i = c + 1; i < n; i++) {
            const double factor = a[i * n + c] / a[c * n + c];
            for (j = c + 1; j < n; j++)
                a[i * n + j] -= factor * a[c * n + j];
            for (j = 0; j < m; j++)
                b[i * m + j] -= factor * b[c * m + j];
        }
    }
    for (i = n - 1; i >= 0; i--)
        for (j = 0; j < m; j++) {
            for (c = i + 1; c < n; c++)
                b[i * m + j] -= a[i * n + c] * b[c * m + j];
            b[i * m + j] /= a[i * n + i];
        }
    return 1;
}
