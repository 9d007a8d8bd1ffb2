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
