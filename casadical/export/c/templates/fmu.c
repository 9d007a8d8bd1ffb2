/* FMI 2.0 co-simulation around @name@. Written by casadical; do not edit. */
#include <stddef.h>
#include "@name@.h"

#if defined(_WIN32)
#define FMU_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMU_EXPORT __attribute__((visibility("default")))
#else
#define FMU_EXPORT
#endif
#ifdef FMI2_FUNCTION_PREFIX
#define FMU_GLUE(prefix, function) prefix##function
#define FMU_JOIN(prefix, function) FMU_GLUE(prefix, function)
#define FMU(function) FMU_JOIN(FMI2_FUNCTION_PREFIX, function)
#else
#define FMU(function) function
#endif

#define OUTPUTS @n_out@U
static const unsigned int OK_STATUS = 0U;
static const unsigned int ERROR_STATUS = 3U;

typedef void (*log_function)(void *environment, const char *instance, int status, const char *category,
                             const char *message, ...);
typedef struct
{
    log_function logger;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*step_finished)(void *environment, int status);
    void *environment;
} callbacks;

typedef struct
{
    void (*release)(void *memory);
    double q[@NAME@_JOINTS];
    double out[OUTPUTS];
    int enable;
    int status;
@state@} instance;

static void start(instance *it)
{
    static const double middle[@NAME@_JOINTS] = { @middle@ };
    unsigned int i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        it->q[i] = middle[i];
    }
    for (i = 0U; i < OUTPUTS; i++)
    {
        it->out[i] = 0.0;
    }
    it->enable = 1;
    it->status = 0;
@reset@}

/* one call of the controller's function */
static void call(instance *it)
{
    @name@_real q[@NAME@_JOINTS];
    @name@_real out[OUTPUTS];
    unsigned int i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        q[i] = (@name@_real)it->q[i];
    }
    it->status = (int)@call@;
    for (i = 0U; i < OUTPUTS; i++)
    {
        it->out[i] = (double)out[i];
    }
}

FMU_EXPORT const char *FMU(fmi2GetTypesPlatform)(void) { return "default"; }
FMU_EXPORT const char *FMU(fmi2GetVersion)(void) { return "2.0"; }
FMU_EXPORT unsigned int FMU(fmi2SetDebugLogging)(void *c, int on, size_t n, const char *const categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return OK_STATUS;
}

FMU_EXPORT void *FMU(fmi2Instantiate)(const char *name, int type, const char *guid, const char *resources,
                                      const callbacks *functions, int visible, int logging)
{
    instance *it = NULL;
    (void)guid, (void)resources, (void)visible, (void)logging;
    if ((functions != NULL) && (functions->allocate != NULL) && (type == 1))
    {
        if (@name@_self_test() == @NAME@_OK)
        {
            it = (instance *)functions->allocate(1U, sizeof(instance));
        }
        else if (functions->logger != NULL)
        {
            functions->logger(functions->environment, name, (int)ERROR_STATUS, "logStatusError",
                              "@name@: this build does not compute what was exported");
        }
    }
    if (it != NULL)
    {
        it->release = functions->release;
        start(it);
    }
    return it;
}

FMU_EXPORT void FMU(fmi2FreeInstance)(void *c)
{
    instance *it = (instance *)c;
    if ((it != NULL) && (it->release != NULL))
    {
        it->release(it);
    }
}

FMU_EXPORT unsigned int FMU(fmi2SetupExperiment)(void *c, int defined, double tolerance, double from, int has_end, double end)
{
    (void)c, (void)defined, (void)tolerance, (void)from, (void)has_end, (void)end;
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2EnterInitializationMode)(void *c) { return (c != NULL) ? OK_STATUS : ERROR_STATUS; }
FMU_EXPORT unsigned int FMU(fmi2ExitInitializationMode)(void *c)
{
    if (c == NULL)
    {
        return ERROR_STATUS;
    }
@initial@    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2Terminate)(void *c) { return (c != NULL) ? OK_STATUS : ERROR_STATUS; }
FMU_EXPORT unsigned int FMU(fmi2Reset)(void *c)
{
    if (c == NULL)
    {
        return ERROR_STATUS;
    }
    start((instance *)c);
    return OK_STATUS;
}

FMU_EXPORT unsigned int FMU(fmi2GetReal)(void *c, const unsigned int vr[], size_t n, double value[])
{
    const instance *it = (const instance *)c;
    size_t i;
    for (i = 0U; i < n; i++)
    {
        if (vr[i] >= (@NAME@_JOINTS + OUTPUTS))
        {
            return ERROR_STATUS;
        }
        value[i] = (vr[i] < @NAME@_JOINTS) ? it->q[vr[i]] : it->out[vr[i] - @NAME@_JOINTS];
    }
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SetReal)(void *c, const unsigned int vr[], size_t n, const double value[])
{
    instance *it = (instance *)c;
    size_t i;
    for (i = 0U; i < n; i++)
    {
        if (vr[i] >= @NAME@_JOINTS)
        {
            return ERROR_STATUS;
        }
        it->q[vr[i]] = value[i];
    }
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetInteger)(void *c, const unsigned int vr[], size_t n, int value[])
{
    size_t i;
    for (i = 0U; i < n; i++)
    {
        if (vr[i] != 0U)
        {
            return ERROR_STATUS;
        }
        value[i] = ((const instance *)c)->status;
    }
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SetInteger)(void *c, const unsigned int vr[], size_t n, const int value[])
{
    (void)c, (void)vr, (void)value;
    return (n == 0U) ? OK_STATUS : ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetBoolean)(void *c, const unsigned int vr[], size_t n, int value[])
{
    size_t i;
    for (i = 0U; i < n; i++)
    {
        if (vr[i] != 0U)
        {
            return ERROR_STATUS;
        }
        value[i] = ((const instance *)c)->enable;
    }
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SetBoolean)(void *c, const unsigned int vr[], size_t n, const int value[])
{
    size_t i;
    for (i = 0U; i < n; i++)
    {
        if (vr[i] != 0U)
        {
            return ERROR_STATUS;
        }
        ((instance *)c)->enable = value[i];
    }
    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetString)(void *c, const unsigned int vr[], size_t n, const char *value[])
{
    (void)c, (void)vr, (void)value;
    return (n == 0U) ? OK_STATUS : ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SetString)(void *c, const unsigned int vr[], size_t n, const char *const value[])
{
    (void)c, (void)vr, (void)value;
    return (n == 0U) ? OK_STATUS : ERROR_STATUS;
}

FMU_EXPORT unsigned int FMU(fmi2DoStep)(void *c, double time, double size, int no_set_before)
{
    instance *it = (instance *)c;
    (void)time, (void)no_set_before;
    if (it == NULL)
    {
        return ERROR_STATUS;
    }
@do_step@    return OK_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2CancelStep)(void *c)
{
    (void)c;
    return ERROR_STATUS;
}

/* optional parts of the interface, declared absent in modelDescription.xml */
FMU_EXPORT unsigned int FMU(fmi2GetFMUstate)(void *c, void **state) { (void)c, (void)state; return ERROR_STATUS; }
FMU_EXPORT unsigned int FMU(fmi2SetFMUstate)(void *c, void *state) { (void)c, (void)state; return ERROR_STATUS; }
FMU_EXPORT unsigned int FMU(fmi2FreeFMUstate)(void *c, void **state) { (void)c, (void)state; return ERROR_STATUS; }
FMU_EXPORT unsigned int FMU(fmi2SerializedFMUstateSize)(void *c, void *state, size_t *size)
{
    (void)c, (void)state, (void)size;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SerializeFMUstate)(void *c, void *state, char bytes[], size_t size)
{
    (void)c, (void)state, (void)bytes, (void)size;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state)
{
    (void)c, (void)bytes, (void)size, (void)state;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetDirectionalDerivative)(void *c, const unsigned int unknown[], size_t n,
                                                          const unsigned int known[], size_t m, const double seed[],
                                                          double result[])
{
    (void)c, (void)unknown, (void)n, (void)known, (void)m, (void)seed, (void)result;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2SetRealInputDerivatives)(void *c, const unsigned int vr[], size_t n, const int order[],
                                                         const double value[])
{
    (void)c, (void)vr, (void)n, (void)order, (void)value;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetRealOutputDerivatives)(void *c, const unsigned int vr[], size_t n, const int order[],
                                                          double value[])
{
    (void)c, (void)vr, (void)n, (void)order, (void)value;
    return ERROR_STATUS;
}
FMU_EXPORT unsigned int FMU(fmi2GetStatus)(void *c, int kind, int *value) { (void)c, (void)kind, (void)value; return 2U; }
FMU_EXPORT unsigned int FMU(fmi2GetRealStatus)(void *c, int kind, double *value) { (void)c, (void)kind, (void)value; return 2U; }
FMU_EXPORT unsigned int FMU(fmi2GetIntegerStatus)(void *c, int kind, int *value) { (void)c, (void)kind, (void)value; return 2U; }
FMU_EXPORT unsigned int FMU(fmi2GetBooleanStatus)(void *c, int kind, int *value) { (void)c, (void)kind, (void)value; return 2U; }
FMU_EXPORT unsigned int FMU(fmi2GetStringStatus)(void *c, int kind, const char **value) { (void)c, (void)kind, (void)value; return 2U; }
