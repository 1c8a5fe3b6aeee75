/* A controller: measurements and references in, inputs of the plant out.
 *
 * Call {{ name }}_reset once, and {{ name }}_act once in each control period of {{ dt }} s.
 *
{{ about | block }}
 */
#ifndef {{ name | upper }}_H
#define {{ name | upper }}_H

#ifdef __cplusplus
extern "C" {
#endif

enum {
    {{ name }}_NX = {{ signature.n_x }}, /* states */
    {{ name }}_NU = {{ signature.n_u }}, /* inputs of the plant */
    {{ name }}_NR = {{ task.n_r }}, /* tracked states */
@ if observer
    {{ name }}_N = {{ size | length }}, /* states of the observer: those of the plant, then the pushes */
    {{ name }}_MEMORY = {{ memory }}, /* past inputs that the observer needs */
@ endif
    {{ name }}_OK = 0,
    {{ name }}_REFUSED = 1
};

/* Places in the arrays, by name. */
enum {
{{ places | join(",\n") }}
};

typedef struct {
@ if observer
    double begun;                               /* 1 where anything was measured */
    double x[{{ name }}_N];                     /* estimate at the time of the last measurement that has arrived */
    double p[{{ name }}_N][{{ name }}_N];       /* covariance of its errors */
    double inputs[{{ name }}_MEMORY][{{ name }}_NU]; /* the inputs so far, the last one at the end */
@ endif
@ if pushed
    double shift[{{ name }}_NX + {{ name }}_NU]; /* part of state and input that counteracts the push */
@ endif
@ if integral
    double integral[{{ name }}_NR];             /* integral of the error */
@ endif
    double u[{{ name }}_NU];                    /* the inputs that were returned last */
} {{ name }}_state;

/* Forget what was measured: the next call takes the plant as at rest, its inputs zero. */
void {{ name }}_reset({{ name }}_state *s);

/* Return in u the inputs of the control period that begins now, each within its limits above.
 *
@ if observer
 * y     what was measured now, NaN where nothing was; the sensors are those of {{ measured }}
@ else
 * y     what was measured now, all states
@ endif
 * r     where the tracked states are to be
 * rate  how fast the reference moves [per second]; a null pointer for a reference that rests
 *
 * Returns {{ name }}_OK; or {{ name }}_REFUSED where a number was not finite that has to be, or no finite input follows;
 * then u is as before, and the controller, too. A measurement that no plant could have made counts as none.
 */
int {{ name }}_act({{ name }}_state *s, const double y[{{ name }}_NX], const double r[{{ name }}_NR],
    const double rate[{{ name }}_NR], double u[{{ name }}_NU]);

#ifdef __cplusplus
}
#endif

#endif
