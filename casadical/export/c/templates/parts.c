==== atan2.c
/* angle of the point (x, y); 0 for (0, 0) */
static @real@ @name@_atan2(const @real@ y, const @real@ x)
{
    const @real@ ax = (x < @0@) ? -x : x;
    const @real@ ay = (y < @0@) ? -y : y;
    const @real@ hi = (ay > ax) ? ay : ax;
    const @real@ lo = (ay > ax) ? ax : ay;
    const @real@ edge = @tan_pi_8@ * hi;
    const @real@ den = (lo > edge) ? (hi + lo) : hi;
    const @real@ t = ((lo > edge) ? (lo - hi) : lo) / ((den < @smallest@) ? @1@ : den);
    const @real@ z = t * t;
    const @real@ octant = t + ((t * z) * @poly:atan@);
    const @real@ quarter = (lo > edge) ? (@pi_4@ + octant) : octant;
    const @real@ half = (ay > ax) ? (@pi_2@ - quarter) : quarter;
    const @real@ whole = (x < @0@) ? (@pi@ - half) : half;
    return (y < @0@) ? -whole : whole;
}
==== example.c
/*
 * How to call @name@. Build: cc -std=c99 -O2 @name@.c @name@_self_test.c @name@_example.c -o example
 * Written by casadical; do not edit.
 */
#include <stdio.h>
#include "@name@.h"

int main(void)
{
    const @name@_facts *const facts = @name@_info();
    const @name@_real q[@NAME@_JOINTS] = { @centre@ }; /* the middle of the box */
    @name@_status status = @name@_self_test();
    uint32_t i;

    (void)printf("%s, %s, model %s\n", facts->name, facts->real, facts->model_sha256);
    if (status != @NAME@_OK)
    {
        (void)printf("this build does not compute what was exported: do not use it\n");
        return 1;
    }
@body@    (void)i;
    return 0;
}
==== example_command.c
    {
        /* In a controller: one state per arm, one call per cycle, q the commanded joints, q + dq sent to the drives. */
        @name@_state state = { { @zeros@ }, @0@ };
        @name@_real dq[@NAME@_JOINTS];
        uint32_t cycle;
        for (cycle = 0U; cycle < @all_cycles@U; cycle++)
        {
            status = @name@_step(&state, q, 1U, dq);
        }
        (void)printf("correction after %u cycles, status %d:", (unsigned int)cycle, (int)status);
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            (void)printf(" %.9g", (double)dq[i]);
        }
        (void)printf("\n");
    }
==== example_network.c
    {
        @name@_real @out@[@n_out@];
        status = @name@_@function@(q, @out@);
        (void)printf("@function@, status %d:", (int)status);
        for (i = 0U; i < @n_out@U; i++)
        {
            (void)printf(" %.9g @unit@", (double)@out@[i]);
        }
        (void)printf("\n");
    }
==== exp.c
/* exp(a) for a <= 43, and exp(-43) below -43 */
static @real@ @name@_exp(const @real@ a)
{
    static const @real@ two_to[8] = { @powers:1@ };
    static const @real@ two_to_8[8] = { @powers:8@ }; /* 2^n is a product of two entries */
    const @real@ magnitude = (a < @0@) ? -a : a;
    const @real@ x = (magnitude < @exp_limit@) ? magnitude : @exp_limit@;
    const @real@ nearest = (x * @one_over_ln2@) + @0.5@;
    const uint32_t k = (uint32_t)nearest;
    const @real@ n = (@real@)k;
    const @real@ r = (x - (n * @ln2_high@)) - (n * @ln2_low@);
    const @real@ z = r * r;
    const @real@ R = @2@ + (z * @poly:coth@);
    const @real@ t = two_to[k & 7U] * two_to_8[(k >> 3) & 7U];
    const @real@ up = t * (R + r);
    const @real@ down = R - r;
    return ((a < @0@) ? down : up) / ((a < @0@) ? up : down);
}
==== network.c
@name@_status @name@_@function@(const @name@_real q[@NAME@_JOINTS], @name@_real @out@[@n_out@])
{
    @name@_status status;
    if ((q == NULL) || (@out@ == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        static const @name@_real box[2][@NAME@_JOINTS] = @box_table:network@;
        @name@_real x[@NAME@_JOINTS];
        status = @name@_boxed(q, box, x);
        if ((@name@_@function@_values(x, @out@) == 0U) || (status == @NAME@_NOT_FINITE))
        {
            uint32_t i;
            for (i = 0U; i < @n_out@U; i++)
            {
                @out@[i] = @0@;
            }
            status = @NAME@_NOT_FINITE;
        }
    }
    return status;
}

==== periodic.c
/* a function that repeats every turn, for |x| <= 128 rad: cubic spline on @points@ points, its coefficients over six */
static @real@ @name@_@table@(const @real@ x)
{
    static const @real@ c[@size@] = {
@numbers@
    };
    const @real@ place = (x * @per_radian@) + @offset@; /* positive, so that conversion rounds down */
    const int32_t k = (int32_t)place;
    const @real@ n = (@real@)k - @offset@;
    const @real@ t = ((x - (n * @step_high@)) - (n * @step_low@)) * @per_radian@;
    const uint32_t i = (uint32_t)k & @mask@U;
    const @real@ ends = c[i] + c[i + 2U];
    const @real@ middle = c[i + 1U] + c[i + 1U];
    const @real@ cubic = (c[i + 3U] - c[i]) - (@3@ * (c[i + 2U] - c[i + 1U]));
    const @real@ square = @3@ * (ends - middle);
    const @real@ slope = @3@ * (c[i + 2U] - c[i]);
    return (ends + (middle + middle)) + (t * (slope + (t * (square + (t * cubic)))));
}
==== rows.c

void @name@_@function@_rows(const @name@_real *q, uint64_t rows, @name@_real *out, int32_t *status);
void @name@_@function@_rows(const @name@_real *q, uint64_t rows, @name@_real *out, int32_t *status)
{
    for (uint64_t k = 0; k < rows; k++) {
        status[k] = (int32_t)@name@_@function@(&q[k * @n@U], &out[k * @size@U]);
    }
}
==== rows_step.c

void @name@_step_rows(const @name@_real *q, uint64_t rows, const uint32_t *on, @name@_real *out, int32_t *status);
void @name@_step_rows(const @name@_real *q, uint64_t rows, const uint32_t *on, @name@_real *out, int32_t *status)
{
    @name@_state state = { { 0 }, 0 };
    for (uint64_t k = 0; k < rows; k++) {
        status[k] = (int32_t)@name@_step(&state, &q[k * @n@U], on[k], &out[k * @n@U]);
    }
}
==== self_test.c
/* Known answers of @name@, recomputed bit for bit. Written by casadical; do not edit. */
#include <float.h>
#include <stddef.h>
#include "@name@.h"

#define @NAME@_TEST_ROWS @rows@U

static const @name@_real @name@_test_inputs[@NAME@_TEST_ROWS][@NAME@_JOINTS] = {
@inputs@
};

/* 1 where every pair is equal; a NaN is equal to nothing */
static uint32_t @name@_equal(const @name@_real *const a, const @name@_real *const b, const uint32_t count)
{
    uint32_t same = 1U;
    uint32_t i;
    for (i = 0U; i < count; i++)
    {
        if (!((a[i] >= b[i]) && (a[i] <= b[i])))
        {
            same = 0U;
        }
    }
    return same;
}

@functions@
@name@_status @name@_self_test(void)
{
    const volatile @name@_real huge = @MAX@;
    const @name@_real infinity_now = huge * huge;
    const @name@_real bad[3] = { infinity_now, -infinity_now, infinity_now - infinity_now };
    uint32_t passed = 1U;
    uint32_t i;
@checks@
    for (i = 0U; i < (3U * @NAME@_JOINTS); i++)
    {
        @name@_real q[@NAME@_JOINTS];
        uint32_t k;
        for (k = 0U; k < @NAME@_JOINTS; k++)
        {
            q[k] = @name@_test_inputs[0][k];
        }
        q[i / 3U] = bad[i % 3U];
@bad_checks@    }
    return (passed != 0U) ? @NAME@_OK : @NAME@_SELF_TEST_FAILED;
}
==== self_test_rows.c
static uint32_t @name@_test_@function@(void)
{
    static const @name@_real expected[@NAME@_TEST_ROWS][@size@] = {
@expected@
    };
    static const uint8_t status[@NAME@_TEST_ROWS] = { @statuses@ };
    uint32_t passed = 1U;
    uint32_t i;
    for (i = 0U; i < @NAME@_TEST_ROWS; i++)
    {
        @name@_real out[@size@];
        const @name@_status found = @name@_@function@(@name@_test_inputs[i], out);
        if (((uint32_t)found != status[i]) || (@name@_equal(out, expected[i], @size@U) == 0U))
        {
            passed = 0U;
        }
    }
    return passed;
}

/* an input that is not finite gives zeros and says so; a NULL gives NULL_ARG */
static uint32_t @name@_test_bad_@function@(const @name@_real q[@NAME@_JOINTS])
{
    @name@_real out[@size@];
    uint32_t passed = 1U;
    uint32_t i;
    if (@name@_@function@(q, out) != @NAME@_NOT_FINITE)
    {
        passed = 0U;
    }
    for (i = 0U; i < @size@U; i++)
    {
        const @name@_real zero = @0@;
        passed = passed & @name@_equal(&out[i], &zero, 1U);
    }
    if ((@name@_@function@(NULL, out) != @NAME@_NULL_ARG) || (@name@_@function@(q, NULL) != @NAME@_NULL_ARG))
    {
        passed = 0U;
    }
    return passed;
}

==== self_test_step.c
static uint32_t @name@_test_step(void)
{
    static const @name@_real expected[@cycles@][@NAME@_JOINTS] = {
@expected_step@
    };
    static const uint8_t status[@cycles@] = { @statuses_step@ };
    @name@_state state = { { @zeros@ }, @0@ };
    uint32_t passed = 1U;
    uint32_t i;
    for (i = 0U; i < @cycles@U; i++)
    {
        @name@_real dq[@NAME@_JOINTS];
        const @name@_status found =
            @name@_step(&state, @name@_test_inputs[0], (i < @on_cycles@U) ? 1U : 0U, dq);
        if (((uint32_t)found != status[i]) || (@name@_equal(dq, expected[i], @NAME@_JOINTS) == 0U))
        {
            passed = 0U;
        }
    }
    return passed;
}

==== sincos.c
/* sine and cosine of |x| <= 1024 rad: x is reduced by multiples of pi/2 stored in two parts */
static void @name@_sincos(const @real@ x, @real@ pair[2])
{
    const @real@ nearest = (x * @two_over_pi@) + @1024.5@; /* positive, so that conversion rounds down */
    const int32_t k = (int32_t)nearest;
    const @real@ n = (@real@)k - @1024@;
    const @real@ r = (x - (n * @half_pi_high@)) - (n * @half_pi_low@);
    const @real@ z = r * r;
    const @real@ s = r + ((r * z) * @poly:sin@);
    const @real@ c = (@1@ - (@0.5@ * z)) + ((z * z) * @poly:cos@);
    const uint32_t quadrant = (uint32_t)k;
    const @real@ a = ((quadrant & 1U) != 0U) ? c : s;
    const @real@ b = ((quadrant & 1U) != 0U) ? s : c;
    pair[0] = ((quadrant & 2U) != 0U) ? -a : a;
    pair[1] = (((quadrant + 1U) & 2U) != 0U) ? -b : b;
}
==== sqrt.c
/* square root of x >= 0: x is brought into [1, 4) by powers of four, then Heron's steps */
static @real@ @name@_sqrt(const @real@ x)
{
    static const @real@ power[@sqrt_count@] = { @sqrt_power@ };
    static const @real@ root[@sqrt_count@] = { @sqrt_root@ };
    static const @real@ inverse[@sqrt_count@] = { @sqrt_inverse@ };
    static const @real@ inverse_root[@sqrt_count@] = { @sqrt_inverse_root@ };
    @real@ m = x;
    @real@ s = @1@;
    @real@ y;
    uint32_t i;
    for (i = 0U; i < @sqrt_count@U; i++)
    {
        if (m >= power[i])
        {
            m = m * inverse[i];
            s = s * root[i];
        }
        else if (m < (@4@ * inverse[i]))
        {
            m = m * power[i];
            s = s * inverse_root[i];
        }
        else
        {
            /* in range */
        }
    }
    y = @guess_0@ + (m * (@guess_1@ + (m * @guess_2@)));
    for (i = 0U; i < @heron@U; i++)
    {
        y = @0.5@ * (y + (m / y));
    }
    return (x < @smallest@) ? @0@ : (s * y);
}
==== tansig.c
/* hyperbolic tangent: 2|a| = n ln 2 + r, exp(r) = (R + r)/(R - r) with R = r coth(r/2), and one division */
static @real@ @name@_tansig(const @real@ a)
{
    static const @real@ two_to[8] = { @powers:1@ };
    static const @real@ two_to_8[8] = { @powers:8@ }; /* 2^n is a product of two entries */
    const @real@ magnitude = (a < @0@) ? -a : a;
    const @real@ x = (magnitude < @tansig_limit@) ? magnitude : @tansig_limit@;
    const @real@ y = x + x;
    const @real@ nearest = (y * @one_over_ln2@) + @0.5@;
    const uint32_t k = (uint32_t)nearest;
    const @real@ n = (@real@)k;
    const @real@ r = (y - (n * @ln2_high@)) - (n * @ln2_low@);
    const @real@ z = r * r;
    const @real@ R = @2@ + (z * @poly:coth@);
    const @real@ t = two_to[k & 7U] * two_to_8[(k >> 3) & 7U];
    const @real@ up = t + @1@;
    const @real@ down = t - @1@;
    const @real@ value = ((down * R) + (up * r)) / ((up * R) + (down * r));
    const @real@ bounded = (value < @1@) ? value : @1@; /* makes the bound provable; rounding never exceeds it */
    return (a < @0@) ? -bounded : bounded;
}
