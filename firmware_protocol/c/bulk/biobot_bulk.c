#include "biobot_bulk.h"

#include <string.h>

#define LINK_HEADER_SIZE 4u
#define LINK_DATA 3u
#define RADIO_RECEIVED_SIZE 5u /* type, source, RSSI, LQI */
#define RSSI_UNKNOWN 127
#define PATH_UNKNOWN 0xFFFFu
#define MAX_ENCODED (BB_MAX_FRAME_BODY + 3u)
#define CRC_SIZE 2u

/* Where an uplink message has what (WIRE_FORMAT.md sections 5.1, 5.3 and 5.9), for the short way alone. */
#define HEADER_SIZE 12u
#define BATCH_ENTRY_SIZE 10u
#define PATHS_ENTRY_SIZE 12u
#define MOST_BATCH_ENTRIES 4u
#define MOST_PATHS_ENTRIES 3u

static uint16_t get_u16(const uint8_t *bytes)
{
    return (uint16_t)((unsigned)bytes[0] | (unsigned)bytes[1] << 8);
}

static uint32_t get_u32(const uint8_t *bytes)
{
    return (uint32_t)get_u16(bytes) | (uint32_t)get_u16(bytes + 2) << 16;
}

/* --- checksum: eight bytes a step -------------------------------------------------------------------------------------------- */

/* table[k][b]: what byte b leaves in the register after k more zero bytes. A register and eight bytes then need eight looks that do not wait
 * for each other, where a byte at a time would wait for the one before. Made anew for each call, in a microsecond, so nothing is shared
 * between threads. */
struct crc_tables {
    uint16_t table[8][256];
};

static void make_tables(struct crc_tables *crc)
{
    unsigned k;
    unsigned b;
    for (b = 0; b < 256u; b++) {
        unsigned value = b << 8;
        unsigned bit;
        for (bit = 0; bit < 8u; bit++) {
            value = (value & 0x8000u) != 0u ? value << 1 ^ 0x1021u : value << 1;
        }
        crc->table[0][b] = (uint16_t)value;
    }
    for (k = 1; k < 8u; k++) {
        for (b = 0; b < 256u; b++) {
            unsigned value = crc->table[k - 1u][b];
            crc->table[k][b] = (uint16_t)((value << 8) ^ crc->table[0][value >> 8 & 0xFFu]);
        }
    }
}

static uint16_t checksum(const struct crc_tables *crc, const uint8_t *bytes, unsigned length)
{
    const uint16_t(*t)[256] = crc->table;
    unsigned value = 0xFFFFu;
    while (length >= 8u) {
        value = (unsigned)t[7][bytes[0] ^ value >> 8] ^ t[6][bytes[1] ^ (value & 0xFFu)] ^ t[5][bytes[2]] ^ t[4][bytes[3]] ^ t[3][bytes[4]] ^
                t[2][bytes[5]] ^ t[1][bytes[6]] ^ t[0][bytes[7]];
        bytes += 8;
        length -= 8u;
    }
    while (length != 0u) {
        value = (value << 8 & 0xFFFFu) ^ t[0][*bytes++ ^ value >> 8];
        length--;
    }
    return (uint16_t)value;
}

/* --- messages into columns --------------------------------------------------------------------------------------------------- */

struct sink {
    const struct bb_bulk_columns *columns;
    struct bb_bulk_progress *progress;
    struct crc_tables crc;
    bool is_bare;
};

static void put_header(const struct sink *sink, uint8_t type, uint16_t node, uint16_t boot, uint16_t sequence, uint32_t sent_ms)
{
    const struct bb_bulk_columns *columns = sink->columns;
    uint32_t at = sink->progress->n_frames;
    columns->type[at] = type;
    columns->node[at] = node;
    columns->boot[at] = boot;
    columns->sequence[at] = sequence;
    columns->sent_ms[at] = sent_ms;
}

static void put_source(const struct sink *sink, uint16_t source, int8_t rssi_dbm, uint8_t lqi)
{
    uint32_t at = sink->progress->n_frames;
    sink->columns->source[at] = source;
    sink->columns->rssi_dbm[at] = rssi_dbm;
    sink->columns->lqi[at] = lqi;
}

/* An entry as it stands on the wire, without its path. */
static void put_entry(const struct sink *sink, const uint8_t *entry, uint16_t path_mm)
{
    const struct bb_bulk_columns *columns = sink->columns;
    uint32_t at = sink->progress->n_entries++;
    columns->peer[at] = get_u16(entry);
    columns->start_ms[at] = get_u32(entry + 2);
    columns->duration_ms[at] = bb_encounter_duration_ms(entry[6], get_u16(entry + 7));
    columns->is_ongoing[at] = bb_encounter_is_ongoing(entry[6]);
    columns->entry_rssi_dbm[at] = (int8_t)entry[9];
    columns->path_mm[at] = path_mm;
}

/* The entries of a batch that is known to be good. */
static void put_entries(const struct sink *sink, uint8_t type, const uint8_t *entries, unsigned size)
{
    const uint8_t *end = entries + size;
    if (type == BB_TYPE_ENCOUNTER_BATCH) {
        for (; entries < end; entries += BATCH_ENTRY_SIZE) {
            put_entry(sink, entries, PATH_UNKNOWN);
        }
    } else if (type == BB_TYPE_ENCOUNTER_BATCH_WITH_PATHS) {
        for (; entries < end; entries += PATHS_ENTRY_SIZE) {
            put_entry(sink, entries, get_u16(entries + BATCH_ENTRY_SIZE));
        }
    }
}

static bool is_batch(const uint8_t *payload, unsigned size)
{
    if (payload[0] == BB_TYPE_ENCOUNTER_BATCH) {
        return size % BATCH_ENTRY_SIZE == 0u && size != 0u && size <= MOST_BATCH_ENTRIES * BATCH_ENTRY_SIZE;
    }
    return payload[0] == BB_TYPE_ENCOUNTER_BATCH_WITH_PATHS && size % PATHS_ENTRY_SIZE == 0u && size != 0u &&
           size <= MOST_PATHS_ENTRIES * PATHS_ENTRY_SIZE;
}

/* Take a radio payload; returns its bb_bulk_status. */
static uint8_t take_payload(const struct sink *sink, const uint8_t *payload, unsigned length)
{
    struct bb_uplink message;
    uint8_t fault;
    if (length >= HEADER_SIZE + CRC_SIZE && payload[1] == BB_PROTOCOL_VERSION && is_batch(payload, length - HEADER_SIZE - CRC_SIZE) &&
        checksum(&sink->crc, payload, length) == 0u) {
        put_header(sink, payload[0], get_u16(payload + 2), get_u16(payload + 4), get_u16(payload + 6), get_u32(payload + 8));
        put_entries(sink, payload[0], payload + HEADER_SIZE, length - HEADER_SIZE - CRC_SIZE);
        return BB_BULK_UPLINK;
    }
    fault = bb_decode_uplink(payload, (uint8_t)length, &message);
    if (fault != BB_OK) {
        return (uint8_t)(BB_BULK_MESSAGE_FAULT + fault);
    }
    put_header(sink, message.header.type, message.header.node, message.header.boot, message.header.sequence, message.header.sent_ms);
    return BB_BULK_UPLINK;
}

/* Take a frame body; returns its bb_bulk_status. */
static uint8_t take_body(const struct sink *sink, const uint8_t *body, unsigned length)
{
    const uint8_t *envelope = body + LINK_HEADER_SIZE;
    if (sink->is_bare) {
        return take_payload(sink, body, length);
    }
    if (length < LINK_HEADER_SIZE + RADIO_RECEIVED_SIZE || body[0] != LINK_DATA || envelope[0] != BB_TYPE_RADIO_RECEIVED) {
        return BB_BULK_OTHER;
    }
    put_source(sink, get_u16(envelope + 1), (int8_t)envelope[3], envelope[4]);
    return take_payload(sink, envelope + RADIO_RECEIVED_SIZE, length - LINK_HEADER_SIZE - RADIO_RECEIVED_SIZE);
}

/* --- frames ------------------------------------------------------------------------------------------------------------------ */

static void put_result(const struct sink *sink, uint8_t result, const uint8_t *body, unsigned length)
{
    uint32_t at = sink->progress->n_frames;
    put_header(sink, 0, 0, 0, 0, 0);
    put_source(sink, 0xFFFFu, RSSI_UNKNOWN, 0);
    sink->columns->status[at] = result == BB_FRAME_BODY ? take_body(sink, body, length) : (uint8_t)(BB_BULK_FRAME_FAULT + result);
    sink->columns->entries_end[at] = sink->columns->first_entry + sink->progress->n_entries;
    sink->progress->n_frames++;
}

/* Decode a whole run of 1 to MAX_ENCODED bytes, none of them 0, as bb_frame_decode does byte by byte. */
static uint8_t decode_run(const struct crc_tables *crc, const uint8_t *run, unsigned size, uint8_t *body, unsigned *length)
{
    unsigned n = 0;
    while (size != 0u) {
        unsigned code = run[0];
        if (code > size) {
            return BB_FRAME_BAD_STUFFING;
        }
        memcpy(body + n, run + 1, code - 1u);
        n += code - 1u;
        run += code;
        size -= code;
        if (size != 0u) {
            body[n++] = 0; /* a run is too short for a block of 254 bytes and another behind it */
        }
    }
    if (n <= CRC_SIZE) {
        return BB_FRAME_TOO_SHORT;
    }
    *length = n - CRC_SIZE;
    return checksum(crc, body, n) == 0u ? BB_FRAME_BODY : BB_FRAME_BAD_CRC;
}

static bool has_room(const struct sink *sink)
{
    return sink->progress->n_frames < sink->columns->frames_size &&
           sink->progress->n_entries + BB_BULK_MOST_ENTRIES <= sink->columns->entries_size;
}

void bb_bulk_decode(struct bb_frame_decoder *decoder, const uint8_t *bytes, uint32_t length, bool is_bare,
                    const struct bb_bulk_columns *columns, struct bb_bulk_progress *progress)
{
    struct sink sink;
    uint8_t body[MAX_ENCODED];
    unsigned body_length = 0;
    sink.columns = columns;
    sink.progress = progress;
    sink.is_bare = is_bare;
    make_tables(&sink.crc);
    progress->n_bytes = 0;
    progress->n_frames = 0;
    progress->n_entries = 0;
    while (progress->n_bytes < length && has_room(&sink)) {
        const uint8_t *run = bytes + progress->n_bytes;
        const uint8_t *end = decoder->n_encoded == 0u ? memchr(run, 0, length - progress->n_bytes) : NULL;
        uint32_t size = end == NULL ? 0u : (uint32_t)(end - run);
        uint8_t result;
        if (end != NULL && size <= MAX_ENCODED) {
            progress->n_bytes += size + 1u;
            if (size != 0u) {
                result = decode_run(&sink.crc, run, size, body, &body_length);
                put_result(&sink, result, body, body_length);
            }
            continue;
        }
        /* The end of the frame is not here, or too far: byte by byte. */
        result = bb_frame_decode(decoder, *run);
        progress->n_bytes++;
        if (result != BB_FRAME_NONE) {
            put_result(&sink, result, decoder->body, decoder->length);
        }
    }
}
