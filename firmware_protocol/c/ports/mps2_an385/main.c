/* The reference coordinator on the MPS2 with AN385: UART 0 to the base station, the bench radio in place of a chip's. */
#include "bb_bench_radio.h"
#include "biobot_coordinator.h"
#include "board.h"

#define CHUNK 64U

uint32_t bb_port_now_ms(void) { return board_clock_ms(); }

uint16_t bb_port_uart_room(void) { return board_uart_room(); }

void bb_port_uart_write(const uint8_t *bytes, uint8_t length) { board_uart_write(bytes, length); }

/* Say what the ring of the serial line has lost since the last call, if there is room to say it. */
static void report_lost_octets(void) {
    static const char text[] = "octets lost at the serial line";
    static uint16_t reported;
    uint16_t lost = board_uart_lost();
    if (lost != reported && bb_coordinator_log(BB_LOG_WARNING, BOARD_LOG_OCTETS_LOST, text, sizeof text - 1U)) reported = lost;
}

int main(void) {
    uint8_t chunk[CHUNK];
    board_clock_start();
    board_uart_start();
    bb_coordinator_start();
    bb_bench_start(board_clock_ms());
    for (;;) {
        uint16_t n;
        while ((n = board_uart_read(chunk, CHUNK)) != 0U) bb_coordinator_uart_received(chunk, n);
        bb_bench_poll(board_clock_ms());
        bb_coordinator_poll();
        report_lost_octets();
        board_sleep();
    }
}
