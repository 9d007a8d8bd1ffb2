/* Start-up, printing and an instruction counter for a 64-bit core under QEMU (semihosting, virtual counter with -icount). */
#include <stdint.h>
#include "cortex.h"

extern int main(void);
void start64(void);

__asm__(".section .vectors,\"ax\"\n.global reset\nreset:\n ldr x0, =stack_top\n mov sp, x0\n"
        " mov x1, #(3 << 20)\n msr cpacr_el1, x1\n isb\n bl start64\n .ltorg\n.text\n");

static void semihost(uint32_t op, const void *argument)
{
    register uint64_t x0 __asm__("x0") = op;
    register const void *x1 __asm__("x1") = argument;
    __asm__ volatile("hlt 0xf000" : "+r"(x0) : "r"(x1) : "memory");
}

void print(const char *text) { semihost(4U, text); }

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

void start64(void)
{
    const uint64_t block[2] = {0x20026U, (uint64_t)main()};
    semihost(0x18U, block);
    for (;;) {
    }
}

/* counts down, as SysTick does */
uint32_t ticks(void)
{
    uint64_t count;
    __asm__ volatile("isb\n mrs %0, cntvct_el0" : "=r"(count));
    return (uint32_t)(0U - count);
}
