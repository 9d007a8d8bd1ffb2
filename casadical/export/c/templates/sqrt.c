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
