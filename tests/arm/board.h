/* The little of an emulated Cortex-M board that the tests need: files of the host by semihosting, a count of
 * instructions, and how deep the stack went. */
#ifndef BOARD_H
#define BOARD_H

#include <stddef.h>
#include <stdint.h>

enum { INSTRUCTIONS_A_TICK = 40 }; /* SysTick at 25 MHz, and 1 ns an instruction: -icount shift=0 */

/* Ticks since a moment that `ticks` gave, less than 0.6 s ago. */
uint32_t ticks(void);
uint32_t ticks_since(uint32_t then);

/* A file of the host in its working folder; a handle, negative where there is none. */
int host_open(const char *name, int writes);
/* All the bytes asked for, or false. */
int host_read(int file, void *bytes, size_t n);
int host_write(int file, const void *bytes, size_t n);
_Noreturn void host_exit(int code);

/* Fill the stack below the caller with a pattern; bytes of it that were in use since then. */
void stack_paint(void);
size_t stack_used(void);

int main(void);

#endif
