/* hyperbolic tangent: 2|a| = n ln 2 + r, exp(r) = (R + r)/(R - r) with R = r coth(r/2), and one division */
static @real@ @name@_tansig(const @real@ a)
{
    static const @real@ two_to[8] = { @powers:1@ };
    static const @real@ two_to_8[8] = { @powers:8@ }; /* 2^n is a product of two entries */
    const @real@ magnitude = (a < @0@) ? -a : a;
    const @real@ x = (magnitude < @tansig_limit@) ? magnitude : @tansig_limit@;
    const @real@ y = x + x;
    const @real@ nearest = (y * @one_over_ln2@) + @0.5@;
    const uint32_t k = (uint32_t)nearest;
    const @real@ n = (@real@)k;
    const @real@ r = (y - (n * @ln2_high@)) - (n * @ln2_low@);
    const @real@ z = r * r;
    const @real@ R = @2@ + (z * @poly:coth@);
    const @real@ t = two_to[k & 7U] * two_to_8[(k >> 3) & 7U];
    const @real@ up = t + @1@;
    const @real@ down = t - @1@;
    const @real@ value = ((down * R) + (up * r)) / ((up * R) + (down * r));
    const @real@ bounded = (value < @1@) ? value : @1@; /* makes the bound provable; rounding never exceeds it */
    return (a < @0@) ? -bounded : bounded;
}
