/* angle of the point (x, y); 0 for (0, 0) */
static @real@ @name@_atan2(const @real@ y, const @real@ x)
{
    const @real@ ax = (x < @0@) ? -x : x;
    const @real@ ay = (y < @0@) ? -y : y;
    const @real@ hi = (ay > ax) ? ay : ax;
    const @real@ lo = (ay > ax) ? ax : ay;
    const uint32_t second = (lo > (@tan_pi_8@ * hi)) ? 1U : 0U;
    const @real@ den = (second != 0U) ? (hi + lo) : hi;
    const @real@ t = ((second != 0U) ? (lo - hi) : lo) / ((den < @smallest@) ? @1@ : den);
    const @real@ z = t * t;
    const @real@ octant = t + ((t * z) * @poly:atan@);
    const @real@ quarter = (second != 0U) ? (@pi_4@ + octant) : octant;
    const @real@ half = (ay > ax) ? (@pi_2@ - quarter) : quarter;
    const @real@ whole = (x < @0@) ? (@pi@ - half) : half;
    return (y < @0@) ? -whole : whole;
}
