#ifndef CORTEX_H
#define CORTEX_H
#include <stdint.h>
void print(const char *text);
void print_hex(uint64_t value);
uint32_t ticks(void);
#endif
