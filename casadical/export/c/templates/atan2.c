/* angle of the point (x, y); 0 for (0, 0) */
static @real@ @name@_atan2(const @real@ y, const @real@ x)
{
    const @real@ ax = (x < @0@) ? -x : x;
    const @real@ ay = (y < @0@) ? -y : y;
    const @real@ hi = (ay > ax) ? ay : ax;
    const @real@ lo = (ay > ax) ? ax : ay;
    const @real@ edge = @tan_pi_8@ * hi;
    const @real@ den = (lo > edge) ? (hi + lo) : hi;
    const @real@ t = ((lo > edge) ? (lo - hi) : lo) / ((den < @smallest@) ? @1@ : den);
    const @real@ z = t * t;
    const @real@ octant = t + ((t * z) * @poly:atan@);
    const @real@ quarter = (lo > edge) ? (@pi_4@ + octant) : octant;
    const @real@ half = (ay > ax) ? (@pi_2@ - quarter) : quarter;
    const @real@ whole = (x < @0@) ? (@pi@ - half) : half;
    return (y < @0@) ? -whole : whole;
}
