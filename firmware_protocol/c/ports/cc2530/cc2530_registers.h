/* The registers of the CC2530 that this port uses: names and addresses of TI's CC253x user's guide, SWRU191F (tables 2-1 and 23-6 on). */
#ifndef CC2530_REGISTERS_H
#define CC2530_REGISTERS_H

#include <stdint.h>

/* Interrupt numbers, table 2-5. */
#define VECTOR_URX0 2
#define VECTOR_UTX0 7

/* Special function registers and bits. */
__sfr __at(0x86) U0CSR;
__sbit __at(0x8B) URX0IF;
__sfr __at(0x91) RFIRQF1;
__sfr __at(0x95) ST0;
__sfr __at(0x96) ST1;
__sfr __at(0x97) ST2;
__sfr __at(0x9A) IEN2;
__sfr __at(0x9E) CLKCONSTA;
__sbit __at(0xAA) URX0IE;
__sbit __at(0xAF) EA;
__sfr __at(0xBF) RFERRF;
__sfr __at(0xC1) U0DBUF;
__sfr __at(0xC2) U0BAUD;
__sfr __at(0xC4) U0UCR;
__sfr __at(0xC5) U0GCR;
__sfr __at(0xC6) CLKCONCMD;
__sfr __at(0xD9) RFD;
__sfr __at(0xE1) RFST;
__sbit __at(0xE9) UTX0IF;
__sfr __at(0xF1) PERCFG;
__sfr __at(0xF3) P0SEL;

#define XREG(address) (*(volatile __xdata uint8_t *)(address))

/* Radio, chapter 23. */
#define PAN_ID0 XREG(0x6172)
#define PAN_ID1 XREG(0x6173)
#define SHORT_ADDR0 XREG(0x6174)
#define SHORT_ADDR1 XREG(0x6175)
#define FRMFILT0 XREG(0x6180)
#define FRMCTRL0 XREG(0x6189)
#define FREQCTRL XREG(0x618F)
#define TXPOWER XREG(0x6190)
#define FSMSTAT1 XREG(0x6193)
#define FIFOPCTRL XREG(0x6194)
#define CCACTRL0 XREG(0x6196)
#define RFRND XREG(0x61A7)
#define FSCAL1 XREG(0x61AE)
#define AGCCTRL1 XREG(0x61B2)
#define TXFILTCFG XREG(0x61FA)

/* The EUI-64 that TI wrote into the information page, lowest byte first (2.2.3 of the guide). */
#define INFORMATION_EUI64 ((const volatile __xdata uint8_t *)0x780C)

/* Bits. */
#define U0CSR_UART 0x80
#define U0CSR_RECEIVE 0x40
#define U0UCR_FLUSH 0x80
#define U0UCR_8_N_1 0x02
#define IEN2_UTX0 0x04
#define CLKCON_RC_16_MHZ 0x40
#define CLKCON_32_MHZ_CRYSTAL_AND_32_KHZ_RC 0x80
#define FSMSTAT1_FIFO 0x80
#define FSMSTAT1_FIFOP 0x40
#define FSMSTAT1_SAMPLED_CCA 0x08
#define FSMSTAT1_TX_ACTIVE 0x02
#define RFIRQF1_TXDONE 0x02
#define RFERRF_RXOVERF 0x04

/* Command strobes of the radio, table 23-13. */
#define ISRXON 0xE3
#define ISTXONCCA 0xEA
#define ISFLUSHRX 0xED
#define ISFLUSHTX 0xEE
#define ISRFOFF 0xEF

#endif
