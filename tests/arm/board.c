/* Start-up and semihosting of the Cortex-M boards that QEMU has (mps2-an386, mps2-an500). */
#include "board.h"

#include <string.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define CPACR REGISTER(0xE000ED88)
#define SYST_CSR REGISTER(0xE000E010)
#define SYST_RVR REGISTER(0xE000E014)
#define SYST_CVR REGISTER(0xE000E018)
#define TICKS_MASK 0xFFFFFFu

/* Arm, Semihosting for AArch32 and AArch64, 2.0 */
enum { SYS_OPEN = 0x01, SYS_WRITE = 0x05, SYS_READ = 0x06, SYS_EXIT_EXTENDED = 0x20 };
enum { OPEN_RB = 1, OPEN_WB = 5, STOPPED_APPLICATION_EXIT = 0x20026, TRAPPED = 99 };

extern unsigned char data_start[], data_end[], data_image[], bss_start[], bss_end[], stack_top[];

void reset(void);

static intptr_t semihosting(intptr_t operation, const void *arguments)
{
    register intptr_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

int host_open(const char *name, int writes)
{
    const uintptr_t arguments[3] = {(uintptr_t)name, writes ? OPEN_WB : OPEN_RB, strlen(name)};
    return (int)semihosting(SYS_OPEN, arguments);
}

int host_read(int file, void *bytes, size_t n)
{
    const uintptr_t arguments[3] = {(uintptr_t)file, (uintptr_t)bytes, n};
    return semihosting(SYS_READ, arguments) == 0; /* what it gives is how many bytes are missing */
}

int host_write(int file, const void *bytes, size_t n)
{
    const uintptr_t arguments[3] = {(uintptr_t)file, (uintptr_t)bytes, n};
    return semihosting(SYS_WRITE, arguments) == 0;
}

void host_exit(int code)
{
    const uintptr_t arguments[2] = {STOPPED_APPLICATION_EXIT, (uintptr_t)code};
    for (;;) {
        semihosting(SYS_EXIT_EXTENDED, arguments);
    }
}

uint32_t ticks(void)
{
    return SYST_CVR;
}

uint32_t ticks_since(uint32_t then)
{
    return (then - SYST_CVR) & TICKS_MASK; /* it counts down */
}

enum { PAINT = 0xA5, PAINTED = 0x8000 };
static volatile unsigned char *painted;

void stack_paint(void)
{
    painted = (unsigned char *)__builtin_frame_address(0) - 64; /* below this function's own frame */
    for (size_t i = 1; i <= PAINTED; i++) {
        painted[-(ptrdiff_t)i] = PAINT;
    }
}

size_t stack_used(void)
{
    size_t n = PAINTED;
    while (n > 0 && painted[-(ptrdiff_t)n] == PAINT) {
        n--;
    }
    return n + 64;
}

static void trap(void)
{
    host_exit(TRAPPED);
}

void reset(void)
{
    CPACR |= 0xFu << 20; /* the FPU */
    __asm__ volatile("dsb\n\tisb");
    memcpy(data_start, data_image, (size_t)(data_end - data_start));
    memset(bss_start, 0, (size_t)(bss_end - bss_start));
    SYST_RVR = TICKS_MASK;
    SYST_CVR = 0;
    SYST_CSR = 5; /* on, by the processor's clock, without interrupts */
    host_exit(main());
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)stack_top,  (uintptr_t)reset, (uintptr_t)trap, (uintptr_t)trap, (uintptr_t)trap, (uintptr_t)trap,
    (uintptr_t)trap,       (uintptr_t)trap,  (uintptr_t)trap, (uintptr_t)trap, (uintptr_t)trap, (uintptr_t)trap,
    (uintptr_t)trap,       (uintptr_t)trap,  (uintptr_t)trap, (uintptr_t)trap,
};
