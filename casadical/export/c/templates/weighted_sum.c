/* w[0] x[0] + w[1] x[1] + .., added in this order */
static @real@ @name@_weighted_sum(const @real@ *const w, const @real@ *const x, const uint32_t count)
{
    @real@ sum = w[0] * x[0];
    uint32_t i;
    for (i = 1U; i < count; i++)
    {
        sum = sum + (w[i] * x[i]);
    }
    return sum;
}
