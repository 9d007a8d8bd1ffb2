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

