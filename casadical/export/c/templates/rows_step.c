
void @name@_step_rows(const @name@_real *q, uint64_t rows, const uint32_t *on, @name@_real *out, int32_t *status);
void @name@_step_rows(const @name@_real *q, uint64_t rows, const uint32_t *on, @name@_real *out, int32_t *status)
{
    @name@_state state = { { 0 }, 0 };
    for (uint64_t k = 0; k < rows; k++) {
        status[k] = (int32_t)@name@_step(&state, &q[k * @n@U], on[k], &out[k * @n@U]);
    }
}
