@ if found.has("sign")
/* -1, 0 or 1. */
static double sign(double a)
{
    return (double)((a > 0.0) - (a < 0.0));
}

@ endif
@ if found.has("square")
static double square(double a)
{
    return a * a;
}

@ endif
@ if found.has("larger")
/* The larger one; what is no number stays none. */
static double larger(double a, double b)
{
    return a < b ? b : a;
}

@ endif
/* The identified equations, rounded:
 *
{{ model.equations() | block }}
 */
{{ head }}
{
@ for name, formula in found.lines
    const double {{ name }} = {{ formula }};
@ endfor
@ for variable in ("x", "u") if not found.has(variable)
    (void){{ variable }};
@ endfor
@ for formula in found.results
    {{ result }}[{{ loop.index0 }}] = {{ formula }};
@ endfor
}
