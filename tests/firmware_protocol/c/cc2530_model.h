/* The port's registers on a machine that has none: to be included before anything else (gcc -include).
 *
 * Registers are plain memory but for two. A read of FSMSTAT1 carries out the strobe that was written last and tells the state after it; RFD
 * leads into the FIFO that is sent from after ISFLUSHTX, and after a read of FSMSTAT1 into the one that is received into. C cannot tell a
 * read of RFD from a write, and the driver looks at FSMSTAT1 before every frame that it reads.
 */
#ifndef CC2530_MODEL_H
#define CC2530_MODEL_H

#include <stdint.h>

#define __xdata
#define __at(address)
#define __sfr extern volatile uint8_t
#define __sbit extern volatile uint8_t
#include "cc2530_registers.h"

/* Interrupts are not modelled. */
#define CC2530_UART_HANDLERS_H

volatile uint8_t *model_fifo(void);
volatile uint8_t *model_register(uint16_t address);
extern const uint8_t model_eui64[8];

#define RFD (*model_fifo())
#undef XREG
#define XREG(address) (*model_register(address))
#undef INFORMATION_EUI64
#define INFORMATION_EUI64 model_eui64

#endif
