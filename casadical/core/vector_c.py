"""A CasADi SX function as C that computes many points, two at a time in the vector registers that every processor has.

Operations are those of the function in its order, so every bit is what CasADi's own evaluation gives; sines and the
like are those of the C library, one by one. GCC and clang know the vectors.
"""

import math

import casadi as ca

from casadical.core.sx_instructions import OPERATIONS, SxInstructions

_HEAD = """\
#include <math.h>

typedef double real __attribute__((vector_size(16)));
#define BOTH(x) ((real){(x), (x)})
#define ONE(f, a) ((real){f((a)[0]), f((a)[1])})
#define TWO(f, a, b) ((real){f((a)[0], (b)[0]), f((a)[1], (b)[1])})

static inline double sign(double a) { return a < 0 ? -1 : a > 0 ? 1 : a; }
static inline double not_(double a) { return a == 0; }
static inline double lt(double a, double b) { return a < b; }
static inline double le(double a, double b) { return a <= b; }
static inline double eq(double a, double b) { return a == b; }
static inline double ne(double a, double b) { return a != b; }
static inline double and_(double a, double b) { return a != 0 && b != 0; }
static inline double or_(double a, double b) { return a != 0 || b != 0; }
static inline double if_else_zero(double a, double b) { return a != 0 ? b : 0; }
"""


def source(f: ca.Function) -> str | None:
    """C of `void name(long long n, const double *const *in, double *const *out)`; None for operations it has not.

    f : dense SX function; its first input is that of a point, the others are shared by all. The n points, and the
    outputs of each, lie behind one another.
    """
    lines = []
    for name, operands, results, constant in SxInstructions.read(f).instructions:
        if name == "output":
            k, place, value = *results, f"a{operands[0]}"
            lines.append(f"out{k}[{place}] = {value}[0]; out{k}[{place} + more * {f.nnz_out(k)}] = {value}[1];")
            continue
        if name == "input":
            k, place = operands
            value = f"(real){{p0[{place}], p1[{place}]}}" if k == 0 else f"BOTH(in{k}[{place}])"
        elif name == "const":
            value = f"BOTH({_number(constant)})"
        elif name in OPERATIONS:
            value = OPERATIONS[name].c.format(*(f"a{j}" for j in operands))
        else:
            return None
        lines.append(f"a{results[0]} = {value};")
    rows = f.nnz_in(0)
    shared = [f"const double *restrict in{j} = in[{j}];" for j in range(1, f.n_in())]
    outputs = [f"double *restrict out{j} = out[{j}] + i * {f.nnz_out(j)};" for j in range(f.n_out())]
    inside = [f"const double *p0 = in[0] + i * {rows}, *p1 = p0 + more * {rows};", *outputs, *lines]
    return "\n".join(
        (
            _HEAD,
            f"void {f.name()}(long long n, const double *const *in, double *const *out)",
            "{",
            f"    real {', '.join(f'a{k}' for k in range(max(1, f.sz_w())))};",
            *(f"    {line}" for line in shared),
            "    for (long long i = 0; i < n; i += 2) {",
            "        const long long more = i + 1 < n; /* the last of an odd number is computed twice */",
            *(f"        {line}" for line in inside),
            "    }",
            "}",
            "",
        )
    )


def _number(value: float) -> str:
    return value.hex() if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"
