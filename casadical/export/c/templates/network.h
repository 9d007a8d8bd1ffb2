/*
 * Result of the @what@: @out@ at the joints q. Never outside, whatever q is [@unit@]:
@network_bounds@ * Zeros and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_@function@(const @name@_real q[@NAME@_JOINTS], @name@_real @out@[@n_out@]);

