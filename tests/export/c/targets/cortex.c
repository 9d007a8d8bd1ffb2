/* Start-up, printing and an instruction counter for a Cortex-M under QEMU (semihosting, SysTick with -icount). */
#include <stdint.h>
#include "cortex.h"

extern uint32_t stack_top;
extern int main(void);

static uint32_t semihost(uint32_t op, const void *argument)
{
    register uint32_t r0 __asm__("r0") = op;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void print(const char *text) { (void)semihost(4U, text); }

void print_hex(uint64_t value)
{
    char text[20];
    for (int i = 0; i < 16; i++) {
        text[i] = "0123456789abcdef"[(value >> (60 - (4 * i))) & 15U];
    }
    text[16] = '\n';
    text[17] = '\0';
    print(text);
}

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* floating point on */
    __asm__ volatile("dsb\n isb");
    *(volatile uint32_t *)0xE000E014U = 0x00FFFFFFU; /* SysTick counts the processor clock down, no interrupt */
    *(volatile uint32_t *)0xE000E018U = 0U;
    *(volatile uint32_t *)0xE000E010U = 5U;
    const uint32_t block[2] = {0x20026U, (uint32_t)main()};
    (void)semihost(0x20U, block);
    for (;;) {
    }
}

static void fault(void)
{
    print("fault\n");
    const uint32_t block[2] = {0x20026U, 99U};
    (void)semihost(0x20U, block);
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault};

uint32_t ticks(void) { return *(volatile uint32_t *)0xE000E018U; }
