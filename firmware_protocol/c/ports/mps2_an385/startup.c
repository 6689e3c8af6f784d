/* Start of an image on the MPS2 with the AN385 FPGA image (Cortex-M3): vector table and reset handler, no C library.
 *
 * Vector table: ARMv7-M Architecture Reference Manual (DDI 0403E) B1.5.2. Interrupt numbers: Arm AN385, table 2-9.
 */
#include "board.h"

#include <stdint.h>

extern uint32_t board_data_load[], board_data_start[], board_data_end[], board_bss_start[], board_bss_end[], board_stack_top[];

int main(void);

void board_reset(void);
static void board_stuck(void);

typedef void (*handler_t)(void);

#define N_SYSTEM_HANDLERS 14
#define N_INTERRUPTS 32

struct vector_table {
    uint32_t *stack_top;
    handler_t reset;
    handler_t system[N_SYSTEM_HANDLERS];
    handler_t interrupts[N_INTERRUPTS];
};

/* A fault of the processor resets the board: a coordinator that hangs is worse than one that starts again. */
static const struct vector_table vectors __attribute__((section(".vectors"), used)) = {
    .stack_top = board_stack_top,
    .reset = board_reset,
    .system = {board_stuck, board_stuck, board_stuck, board_stuck, board_stuck, 0, 0, 0, 0, board_stuck, board_stuck, 0, board_stuck,
               board_on_systick},
    .interrupts = {[0] = board_on_uart0_receive, [1] = board_on_uart0_transmit},
};

void board_reset(void) {
    const uint32_t *from = board_data_load;
    for (uint32_t *to = board_data_start; to < board_data_end;) *to++ = *from++;
    for (uint32_t *to = board_bss_start; to < board_bss_end;) *to++ = 0;
    (void)main();
    board_restart();
}

static void board_stuck(void) { board_restart(); }

/* SYSRESETREQ of the Application Interrupt and Reset Control Register, DDI 0403E B3.2.6. */
void board_restart(void) {
    *(volatile uint32_t *)0xE000ED0CU = 0x05FA0004U;
    for (;;) {
    }
}
