/*
 * The network's correction dp_mm at the joints q [rad]. Never outside, whatever q is [mm]:
@network_bounds@ * Zeros and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_network(const @name@_real q[@NAME@_JOINTS], @name@_real dp_mm[@n_dp@]);

