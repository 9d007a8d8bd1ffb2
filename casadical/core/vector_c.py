"""A CasADi SX function as C that computes many points, two at a time in the vector registers that every processor has.

Operations are those of the function in its order, so every bit is what CasADi's own evaluation gives; sines and the
like are those of the C library, one by one. GCC and clang know the vectors.
"""

import math

import casadi as ca

# Operations that the vectors know, by what they are in C; {0} and {1} are the operands.
_OPERATORS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
}
# Functions of one number, and of two.
_ONE = {
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_FABS: "fabs",
    ca.OP_SIGN: "sign",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_NOT: "not_",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
}
_TWO = {
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
    ca.OP_FMOD: "fmod",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_LT: "lt",
    ca.OP_LE: "le",
    ca.OP_EQ: "eq",
    ca.OP_NE: "ne",
    ca.OP_AND: "and_",
    ca.OP_OR: "or_",
    ca.OP_IF_ELSE_ZERO: "if_else_zero",
}
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
    for k in range(f.n_instructions()):
        op, to, of = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if op == ca.OP_INPUT:
            value = f"(real){{p0[{of[1]}], p1[{of[1]}]}}" if of[0] == 0 else f"BOTH(in{of[0]}[{of[1]}])"
        elif op == ca.OP_CONST:
            value = f"BOTH({_number(f.instruction_constant(k))})"
        elif op == ca.OP_OUTPUT:
            size = f.nnz_out(to[0])
            lines.append(f"out{to[0]}[{to[1]}] = a{of[0]}[0]; out{to[0]}[{to[1]} + more * {size}] = a{of[0]}[1];")
            continue
        elif op in _OPERATORS:
            value = _OPERATORS[op].format(*(f"a{j}" for j in of))
        elif op in _ONE:
            value = f"ONE({_ONE[op]}, a{of[0]})"
        elif op in _TWO:
            value = f"TWO({_TWO[op]}, a{of[0]}, a{of[1]})"
        else:
            return None
        lines.append(f"a{to[0]} = {value};")
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
    """A number in C, to the bit."""
    return value.hex() if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"
