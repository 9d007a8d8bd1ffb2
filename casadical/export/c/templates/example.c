/*
 * How to call @name@. Build: cc -std=c99 -O2 @name@.c @name@_self_test.c @name@_example.c -o example
 * Written by casadical; do not edit.
 */
#include <stdio.h>
#include "@name@.h"

int main(void)
{
    const @name@_facts *const facts = @name@_info();
    const @name@_real q[@NAME@_JOINTS] = { @centre@ }; /* the middle of the box */
    @name@_status status = @name@_self_test();
    uint32_t i;

    (void)printf("%s, %s, model %s\n", facts->name, facts->real, facts->model_sha256);
    if (status != @NAME@_OK)
    {
        (void)printf("this build does not compute what was exported: do not use it\n");
        return 1;
    }
@body@    (void)i;
    return 0;
}
