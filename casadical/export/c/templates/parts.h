==== command_defines.h

/* Largest correction of a joint [rad or m], and its largest change in one call of @name@_step */
#define @NAME@_DELTA_LIMIT @delta_decimal@
#define @NAME@_CHANGE_LIMIT @change_decimal@
==== command_statuses.h
 *   RATE_LIMITED   the correction is on its way, as fast as it may change
 *   NOT_CONVERGED  more than @tolerance_mm@ mm remained before the last step; the correction is the best so far
 *   LIMITED        the correction is at its limit, all joints scaled alike
 *   SINGULAR       the arm can hardly move its tool in some direction; the correction is damped and within its limit
==== command.h
/* What a caller of @name@_step keeps between two cycles. Start from all zeros. */
typedef struct
{
    @name@_real dq[@NAME@_JOINTS];   /* correction given in the last cycle [rad or m] */
    @name@_real gain;    /* 0: off, 1: all of the correction */
} @name@_state;

/*
 * Where the calibrated robot is at the joints q: @pose_text@.
 * CLAMPED here means further than @NAME@_DELTA_LIMIT outside the box, so that q + dq can be asked.
 * Zeros and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_forward(const @name@_real q[@NAME@_JOINTS], @name@_real p[@n_p@]);

/*
 * The joint correction dq, in the units of q: sent q + dq, the real tool is where the nominal model has it at q@freedom@.
 * @steps@ least-squares steps with the Jacobian at q, damped by lambda^2 = @damping2@ m^2/rad^2. Then the model is looked
 * at again: the status says what remains, and a further step is taken where the last one reduced it to a third or less.
 * |dq[i]| never exceeds @NAME@_DELTA_LIMIT. Zeros and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_correct(const @name@_real q[@NAME@_JOINTS], @name@_real dq[@NAME@_JOINTS]);

/*
 * The same for a controller that calls once in @cycle_s@ s: ramps in over @ramp_s@ s while enable is not 0 and out while
 * it is 0, and changes no joint's correction by more than @NAME@_CHANGE_LIMIT a call, @rate_rad_s@ rad/s. An input that is not
 * finite takes the correction towards zero at that rate; a state that is not finite or beyond the limits is set to zero (NOT_FINITE).
 */
@name@_status @name@_step(@name@_state *state, const @name@_real q[@NAME@_JOINTS], uint32_t enable, @name@_real dq[@NAME@_JOINTS]);

==== network.h
/*
 * Result of the @what@: @out@ at the joints q. Never outside, whatever q is [@unit@]:
@network_bounds@ * Zeros and NOT_FINITE for an input that is not finite.
 */
@name@_status @name@_@function@(const @name@_real q[@NAME@_JOINTS], @name@_real @out@[@n_out@]);

