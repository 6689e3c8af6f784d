/* Milliseconds since the start, from the sleep timer: 24 bits at 32.768 kHz (SWRU191F chapter 11). */
#include "bb_port.h"
#include "cc2530_registers.h"
#include "port.h"

#define TICKS_MASK 0xFFFFFFUL

static uint32_t clock_last;
static uint32_t clock_now_ms;
static uint16_t clock_rest; /* 125/4096 of a millisecond are left over of each tick: below 4096 */

static uint32_t clock_ticks(void)
{
    uint32_t ticks = ST0; /* reading ST0 holds the other two */
    ticks |= (uint32_t)ST1 << 8;
    ticks |= (uint32_t)ST2 << 16;
    return ticks;
}

/* From the 16 MHz RC oscillator, which runs at reset, to the 32 MHz crystal that the radio needs. */
void clock_start(void)
{
    CLKCONCMD = CLKCON_32_MHZ_CRYSTAL_AND_32_KHZ_RC;
    while (CLKCONSTA & CLKCON_RC_16_MHZ) {
    }
    clock_last = clock_ticks();
}

/* To be called at least once in eight minutes: the timer has 24 bits. */
uint32_t bb_port_now_ms(void)
{
    uint32_t ticks = clock_ticks();
    uint32_t passed = ((ticks - clock_last) & TICKS_MASK) * 125UL + clock_rest;
    clock_last = ticks;
    clock_rest = (uint16_t)(passed & 4095UL);
    clock_now_ms += passed >> 12;
    return clock_now_ms;
}
