
void @name@_@function@_rows(const @name@_real *q, uint64_t rows, @name@_real *out, int32_t *status);
void @name@_@function@_rows(const @name@_real *q, uint64_t rows, @name@_real *out, int32_t *status)
{
    for (uint64_t k = 0; k < rows; k++) {
        status[k] = (int32_t)@name@_@function@(&q[k * @n@U], &out[k * @size@U]);
    }
}
