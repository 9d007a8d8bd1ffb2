/* a function that repeats every turn, for |x| <= 128 rad: cubic spline on @points@ points, its coefficients over six */
static @real@ @name@_@table@(const @real@ x)
{
    static const @real@ c[@size@] = {
@numbers@
    };
    const @real@ place = (x * @per_radian@) + @offset@; /* positive, so that conversion rounds down */
    const int32_t k = (int32_t)place;
    const @real@ n = (@real@)k - @offset@;
    const @real@ t = ((x - (n * @step_high@)) - (n * @step_low@)) * @per_radian@;
    const uint32_t i = (uint32_t)k & @mask@U;
    const @real@ ends = c[i] + c[i + 2U];
    const @real@ middle = c[i + 1U] + c[i + 1U];
    const @real@ cubic = (c[i + 3U] - c[i]) - (@3@ * (c[i + 2U] - c[i + 1U]));
    const @real@ square = @3@ * (ends - middle);
    const @real@ slope = @3@ * (c[i + 2U] - c[i]);
    return (ends + (middle + middle)) + (t * (slope + (t * (square + (t * cubic)))));
}
