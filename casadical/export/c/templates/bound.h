
/*
 * The bound [mm] of the error that remains when q + dq is sent: at poses like the measured ones 95 % of the errors of
 * the calibrated model are below it, and it grows where nothing was measured. What the steps leave is beside it.
 * Zero and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_bound(const @name@_real q[@NAME@_JOINTS], @name@_real bound_mm[1]);
