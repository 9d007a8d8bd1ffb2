/*
 * @name@: @title@
 *
 * Written by casadical (schema @schema@). Do not edit: export again instead.
 *
 * Model sha256: @model_sha256@
 * Data sha256:  @data_sha256@
 *
 * Precondition: the controller's own absolute-accuracy option is switched off. With both active the error is
 * corrected twice.
 *
 * C99, @real@ arithmetic. No heap, no mutable statics, re-entrant, no mathematical library; every loop is bounded.
 * The results are the same bits on every machine whose @real@ is IEEE 754 @bits@ with rounding to nearest, as long as
 * the compiler neither reorders (-ffast-math) nor contracts to fused multiply-adds. Call @name@_self_test() once
 * at start: it recomputes known answers, bit for bit, and notices such a build.
 *
 * Joint readings are those of the model, in its order, in @joint_units@. Box of readings that are accepted; from
 * `casadical export c` these are the joint limits of the robot file (and where the network was trained), which may be
 * wider than what was measured:
@box@ *
@notes@ * Status: when several apply, the highest number is returned.
 *   OK             the result is what the model says
 *   CLAMPED        a joint is outside the box; the result is the one of the nearest point of the box
@command_statuses@ *   NOT_FINITE     an input is NaN or infinite, or the model has no real value there; zeros are written
 *   NULL_ARG       a pointer is NULL; nothing was written
 *   SELF_TEST_FAILED  this build does not compute what the exporter computed; do not use it
 */
#ifndef @NAME@_H
#define @NAME@_H

#include <stdint.h>

#ifdef __cplusplus
extern "C"
{
#endif

#define @NAME@_JOINTS @n@U
#define @NAME@_SCHEMA @schema@U
@defines@
typedef @real@ @name@_real;

typedef enum
{
    @NAME@_OK = 0,
    @NAME@_CLAMPED = 1,
    @NAME@_RATE_LIMITED = 2,
    @NAME@_NOT_CONVERGED = 3,
    @NAME@_LIMITED = 4,
    @NAME@_SINGULAR = 5,
    @NAME@_NOT_FINITE = 6,
    @NAME@_NULL_ARG = 7,
    @NAME@_SELF_TEST_FAILED = 8
} @name@_status;

/* What this file was made from. */
typedef struct
{
    const char *name;
    const char *real;
    const char *model_sha256;
    const char *data_sha256;
    uint32_t schema;
    uint32_t joints;
    uint32_t steps;
} @name@_facts;

@prototypes@
/* Recomputes known answers (inside, corners, outside, NaN, infinity, NULL): OK or SELF_TEST_FAILED. */
@name@_status @name@_self_test(void);

/* Name, real type, hashes and sizes. */
const @name@_facts *@name@_info(void);

#ifdef __cplusplus
}
#endif

#endif
