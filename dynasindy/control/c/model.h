/* The identified model, {{ kind }}.
 *
{{ about | block }}
 */
#ifndef {{ name | upper }}_H
#define {{ name | upper }}_H

#ifdef __cplusplus
extern "C" {
#endif

/* Places in the arrays, by name. */
enum {
{{ places | join(",\n") }}
};

{{ head }};

#ifdef __cplusplus
}
#endif

#endif
