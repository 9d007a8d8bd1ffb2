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

