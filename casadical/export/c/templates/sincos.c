/* sine and cosine of |x| <= 1024 rad: x is reduced by multiples of pi/2 held in two parts */
static void @name@_sincos(const @real@ x, @real@ pair[2])
{
    const @real@ nearest = (x * @two_over_pi@) + @1024.5@; /* positive, so that conversion rounds down */
    const int32_t k = (int32_t)nearest;
    const @real@ n = (@real@)k - @1024@;
    const @real@ r = (x - (n * @half_pi_high@)) - (n * @half_pi_low@);
    const @real@ z = r * r;
    const @real@ s = r + ((r * z) * @poly:sin@);
    const @real@ c = (@1@ - (@0.5@ * z)) + ((z * z) * @poly:cos@);
    const uint32_t quadrant = (uint32_t)k;
    const @real@ a = ((quadrant & 1U) != 0U) ? c : s;
    const @real@ b = ((quadrant & 1U) != 0U) ? s : c;
    pair[0] = ((quadrant & 2U) != 0U) ? -a : a;
    pair[1] = (((quadrant + 1U) & 2U) != 0U) ? -b : b;
}
