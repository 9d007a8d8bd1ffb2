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
