/* Milliseconds since the start, from timer 1 of the CMSDK dual timer; SysTick only ends sleep.
 *
 * The timer runs freely, so that no millisecond is lost where an interrupt comes late (an emulator whose host is busy merges ticks).
 * Registers: Cortex-M System Design Kit TRM (DDI 0479) 4.5; SysTick: DDI 0403E B3.3. Both run from the 25 MHz of AN385.
 */
#include "board.h"

#define CLOCK_HZ 25000000U
#define PRESCALE 16U
#define EIGHTHS_PER_MS (CLOCK_HZ / PRESCALE / 125U) /* 12500 eighths of a tick: a whole number, where 1562.5 ticks are none */

#define TIMER1_LOAD (*(volatile uint32_t *)0x40002000U)
#define TIMER1_VALUE (*(volatile const uint32_t *)0x40002004U)
#define TIMER1_CONTROL (*(volatile uint32_t *)0x40002008U)
#define TIMER_ENABLE 0x80U
#define TIMER_PRESCALE_16 0x04U
#define TIMER_32_BIT 0x02U

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010U)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014U)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018U)
#define SYSTICK_ENABLE_WITH_INTERRUPT 0x07U /* from the processor's clock */

static uint32_t clock_last;  /* of the timer, which counts down */
static uint32_t clock_rest;  /* eighths of ticks that do not make a millisecond yet */
static uint32_t clock_now_ms;

void board_clock_start(void) {
    TIMER1_LOAD = 0xFFFFFFFFU;
    TIMER1_CONTROL = TIMER_ENABLE | TIMER_PRESCALE_16 | TIMER_32_BIT;
    clock_last = TIMER1_VALUE;
    SYSTICK_RELOAD = CLOCK_HZ / 1000U - 1U;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = SYSTICK_ENABLE_WITH_INTERRUPT;
}

/* To be called at least once in five minutes, or the multiplication by 8 overflows. */
uint32_t board_clock_ms(void) {
    uint32_t value = TIMER1_VALUE;
    clock_rest += (clock_last - value) * 8U;
    clock_last = value;
    clock_now_ms += clock_rest / EIGHTHS_PER_MS;
    clock_rest %= EIGHTHS_PER_MS;
    return clock_now_ms;
}

void board_on_systick(void) {}

void board_sleep(void) { __asm volatile("wfi"); }
