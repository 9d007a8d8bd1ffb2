/*
 * The exported C on a target: a hash of the results' bits on pseudo-random inputs, and instructions a call on a
 * Cortex-M under QEMU. PRODUCT_HEADER, PREFIX, CALL (network or correct), N_OUT, COUNT, REAL_BITS, LOWER and UPPER come
 * from the command line; so does RAW for code with CasADi's calling convention.
 */
#include <stdint.h>
#include <string.h>
#ifdef CORTEX
#include "cortex.h"
#else
#include <inttypes.h>
#include <stdio.h>
#endif
#ifdef PRODUCT_HEADER
#include PRODUCT_HEADER
#endif

#if REAL_BITS == 32
typedef float real;
typedef uint32_t word;
#else
typedef double real;
typedef uint64_t word;
#endif

static const real lower[6] = {LOWER};
static const real upper[6] = {UPPER};
static uint32_t seed = 12345U;

static real unit(void)
{
    seed = (seed * 1664525U) + 1013904223U;
    return (real)(seed >> 8) * (real)(1.0 / 16777216.0);
}

/* Every sixteenth input is three times as far from zero, so that guards are met as well. */
static void input(uint32_t k, real q[6])
{
    for (int i = 0; i < 6; i++) {
        const real u = unit();
        const real wide = u * (upper[i] - lower[i]);
        q[i] = lower[i] + wide;
        if ((k % 16U) == 15U) {
            q[i] = q[i] * (real)3.0;
        }
    }
}

#ifdef RAW
int RAW(const real **arg, real **res, long long int *iw, real *w, int mem);
static real scratch[4096];
static int call(const real q[6], real out[N_OUT])
{
    const real *arg[1] = {q};
    real *res[1] = {out};
    return RAW(arg, res, 0, scratch, 0);
}
#else
static int call(const real q[6], real out[N_OUT]) { return (int)CALL(q, out); }
#endif

static uint64_t hash = 14695981039346656037U;

static void mix(uint64_t value)
{
    for (int i = 0; i < 8; i++) {
        hash = (hash ^ ((value >> (8 * i)) & 255U)) * 1099511628211U;
    }
}

static void hash_results(uint32_t count)
{
    for (uint32_t k = 0; k < count; k++) {
        real q[6];
        real out[N_OUT];
        word bits;
        input(k, q);
        mix((uint64_t)call(q, out));
        for (int i = 0; i < N_OUT; i++) {
            memcpy(&bits, &out[i], sizeof bits);
            mix((uint64_t)bits);
        }
    }
}

#ifdef CORTEX
/* Bytes of stack below the caller: painted before the call, read after it. */
static __attribute__((noinline)) uint32_t stack_of_a_call(const real q[6], real out[N_OUT])
{
    volatile uint8_t here = 0U;
    volatile uint8_t *const top = &here - 256;
    uint32_t depth = 32768U;
    for (uint32_t i = 0U; i < depth; i++) {
        *(top - i) = 0xA5U;
    }
    (void)call(q, out);
    while ((depth > 0U) && (*(top - (depth - 1U)) == 0xA5U)) {
        depth--;
    }
    return depth + 256U;
}
#endif

int main(void)
{
#ifdef CORTEX
    uint32_t least = 0xFFFFFFFFU;
    uint32_t most = 0U;
    uint32_t sum = 0U;
    for (uint32_t k = 0; k < 256U; k++) {
        real q[6];
        real out[N_OUT];
        input(0U, q); /* inside the box */
        const uint32_t start = ticks();
        (void)call(q, out);
        const uint32_t used = (start - ticks()) & 0x00FFFFFFU;
        least = (used < least) ? used : least;
        most = (used > most) ? used : most;
        sum += used;
    }
    print_hex(least);
    print_hex(most);
    print_hex(sum);
    {
        real q[6];
        real out[N_OUT];
        input(0U, q);
        print_hex(stack_of_a_call(q, out));
    }
    seed = 12345U;
    hash_results(COUNT);
    print_hex(hash);
#else
    hash_results(COUNT);
    printf("%016" PRIx64 "\n", hash);
#endif
    return 0;
}
