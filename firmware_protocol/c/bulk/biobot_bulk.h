/* Many frames at once, into columns: for recordings, on machines with memory to spare. Encounter batches in whole frames take a short way;
 * for all else, biobot_frame.c cuts and biobot_codec.c reads. What it says is what those two say, which its tests ask of it. */
#ifndef BIOBOT_BULK_H
#define BIOBOT_BULK_H

#include "../biobot_codec.h"
#include "../biobot_frame.h"

/* What became of a run of bytes between two delimiters. Above BB_BULK_FRAME_FAULT, a bb_frame_result is added; above
 * BB_BULK_MESSAGE_FAULT, a bb_fault of an uplink message. */
enum bb_bulk_status {
    BB_BULK_UPLINK = 0,        /* an uplink message; the other columns tell it */
    BB_BULK_OTHER = 1,         /* a good frame that carries no uplink message: another link frame, another envelope */
    BB_BULK_FRAME_FAULT = 16,  /* BB_BULK_FRAME_FAULT + bb_frame_result */
    BB_BULK_MESSAGE_FAULT = 32 /* BB_BULK_MESSAGE_FAULT + bb_fault */
};

/* Columns that the caller gives, a value for each frame and for each entry of an encounter batch. */
struct bb_bulk_columns {
    uint32_t frames_size;  /* how many frames there is room for */
    uint32_t entries_size; /* at least BB_BULK_MOST_ENTRIES */
    uint32_t first_entry;  /* entries that the caller has from before, for entries_end to count on from */
    uint8_t *status;
    uint8_t *type;    /* of the message; this and all up to sent_ms are 0 where there is none */
    uint8_t *lqi;     /* of RadioReceived; 0 where there is none */
    int8_t *rssi_dbm; /* the same; 127 */
    uint16_t *source; /* the same; 0xFFFF */
    uint16_t *node;
    uint16_t *boot;
    uint16_t *sequence;
    uint32_t *sent_ms;
    uint32_t *entries_end; /* entries before it, of this frame and all before, are in the columns below */
    uint16_t *peer;
    uint32_t *start_ms;
    uint32_t *duration_ms;
    uint8_t *is_ongoing;
    int8_t *entry_rssi_dbm;
    uint16_t *path_mm; /* 0xFFFF: not known */
};

#define BB_BULK_MOST_ENTRIES 4u

struct bb_bulk_progress {
    uint32_t n_bytes; /* of input, taken */
    uint32_t n_frames;
    uint32_t n_entries;
};

/* Decode until the input or the room ends, and tell how far it went; call again with the same decoder, the rest of the input and empty
 * columns. is_bare: frames carry radio payloads themselves; else link frames with DATA, RadioReceived in them, and the payload in that. */
void bb_bulk_decode(struct bb_frame_decoder *decoder, const uint8_t *bytes, uint32_t length, bool is_bare,
                    const struct bb_bulk_columns *columns, struct bb_bulk_progress *progress);

#endif
