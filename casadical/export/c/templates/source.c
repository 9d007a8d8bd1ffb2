/* @name@: see @name@.h. Written by casadical; do not edit. */
#include <float.h>
#include <stddef.h>
#include "@name@.h"

/* The bits are promised for plain IEEE arithmetic only; @NAME@_ANY_ARITHMETIC is for testing the self-test. */
#ifndef @NAME@_ANY_ARITHMETIC
#if defined(__FAST_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(_M_FP_FAST)
#error "@name@ must not be compiled with -ffast-math or its parts"
#endif
#if defined(__FINITE_MATH_ONLY__)
#if __FINITE_MATH_ONLY__ > 0
#error "@name@ must not be compiled with -ffinite-math-only: its guards would be removed"
#endif
#endif
#if !defined(FLT_EVAL_METHOD)
#error "@name@ needs C99 or later"
#elif @wider@
#error "@name@ must not be computed in a wider type than @real@ (x87); use -msse2 -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off", "no-tree-slp-vectorize") /* gcc 12's vectorizer fuses even so (vfmaddsub) */
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#else
#pragma STDC FP_CONTRACT OFF
#endif
#endif

#if (FLT_RADIX != 2) || (@MANT_DIG@ != @mant_dig@)
#error "@name@ needs IEEE 754 @bits@"
#endif

/* q moved into a box; with NOT_FINITE x is inside the box too */
static @name@_status @name@_boxed(const @name@_real q[@NAME@_JOINTS], const @name@_real box[2][@NAME@_JOINTS], @name@_real x[@NAME@_JOINTS])
{
    @name@_real moved = @0@;
    @name@_status status;
    uint32_t i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        const @name@_real v = q[i];
        const @name@_real a = (v > box[0][i]) ? v : box[0][i];
        const @name@_real b = (a < box[1][i]) ? a : box[1][i];
        const @name@_real d = b - v;
        const @name@_real distance = (d < @0@) ? -d : d;
        moved = moved + (@share@ * distance); /* NaN and infinity stay; the factor keeps finite sums finite */
        x[i] = b;
    }
    if (!(moved <= @largest@))
    {
        status = @NAME@_NOT_FINITE;
    }
    else if (moved > @0@)
    {
        status = @NAME@_CLAMPED;
    }
    else
    {
        status = @NAME@_OK;
    }
    return status;
}

@elementary@
@kernels@
@functions@
const @name@_facts *@name@_info(void)
{
    static const @name@_facts facts = { "@name@", "@real@", "@model_sha256@",
                                        "@data_sha256@", @NAME@_SCHEMA, @NAME@_JOINTS, @steps@U };
    return &facts;
}
