/* exp(a) for a <= 43, and exp(-43) below -43 */
static @real@ @name@_exp(const @real@ a)
{
    const @real@ magnitude = (a < @0@) ? -a : a;
    const @real@ x = (magnitude < @exp_limit@) ? magnitude : @exp_limit@;
    const uint32_t k = (uint32_t)((x * @one_over_ln2@) + @0.5@);
    const @real@ n = (@real@)k;
    const @real@ r = (x - (n * @ln2_high@)) - (n * @ln2_low@);
    const @real@ z = r * r;
    const @real@ R = @2@ + (z * @poly:coth@);
    const @real@ t = @name@_two_to[k & 7U] * @name@_two_to_8[(k >> 3) & 7U];
    const @real@ up = t * (R + r);
    const @real@ down = R - r;
    return ((a < @0@) ? down : up) / ((a < @0@) ? up : down);
}
