/* Snapshots: plain copies of every array, for a program of the same build. */
#include "state.h"

typedef struct {
    uint8_t *write;
    const uint8_t *read;
    int64_t at, room;
} tape;

static void pass(tape *tape, void *place, int64_t size) {
    if (size > 0 && tape->at + size <= tape->room) { /* an empty array has no place, not even for no bytes */
        if (tape->write) memcpy(tape->write + tape->at, place, (size_t)size);
        if (tape->read) memcpy(place, tape->read + tape->at, (size_t)size);
    }
    tape->at += size;
}

/* Pass a growing array: its count, then its elements; on reading, make the room for them. */
static int pass_array(tape *tape, void **place, int64_t *count, int64_t *room, int64_t size) {
    pass(tape, count, sizeof *count);
    if (tape->read) {
        if (*count < 0 || tape->at + *count * size > tape->room) return -1;
        *room = *count;
        *place = *count ? malloc((size_t)(*count * size)) : NULL;
        if (*count && !*place) return -1;
    }
    pass(tape, *place, *count * size);
    return 0;
}

static int pass_links(tape *tape, links *all) {
    int64_t count = all->count, room = all->room;
    void *at = tape->read ? NULL : all->at;
    if (pass_array(tape, &at, &count, &room, sizeof *all->at)) {
        all->at = NULL;
        all->count = all->room = 0;
        return -1;
    }
    *all = (links){at, (int32_t)count, (int32_t)room};
    return 0;
}

static const uint64_t MARK = 0x62696f626f740002u; /* a word that also tells the byte order, and the version of the layout */

/* Sizes of what crosses the border, for binding.py to compare with its own. */
int64_t engine_layout(void) { return (int64_t)(10000 * sizeof(engine_config) + 100 * sizeof(engine_event) + sizeof(engine_leg)); }

static int pass_all(tape *tape, engine *e) {
    uint64_t mark = MARK;
    int64_t inside = (int64_t)(1000 * sizeof(insect) + sizeof(pair_event)), layout = 1000000 * engine_layout() + inside, wanted = layout;
    int64_t n_cells = (int64_t)e->columns * e->rows, n_walls = e->walls.n;
    pass(tape, &mark, sizeof mark);
    pass(tape, &layout, sizeof layout);
    if (tape->at > tape->room && tape->read) return -1;
    if (mark != MARK || layout != wanted) return -2;
    pass(tape, &e->config, sizeof e->config);
    pass(tape, &e->n, sizeof e->n);
    pass(tape, &e->columns, sizeof e->columns);
    pass(tape, &e->rows, sizeof e->rows);
    pass(tape, &e->has_started, sizeof e->has_started);
    pass(tape, &e->now, sizeof e->now);
    pass(tape, &e->cell, sizeof e->cell);
    pass(tape, &e->low_x, sizeof e->low_x);
    pass(tape, &e->low_y, sizeof e->low_y);
    pass(tape, &e->n_steps, sizeof e->n_steps);
    pass(tape, &n_walls, sizeof n_walls);
    if (tape->read) {
        n_cells = (int64_t)e->columns * e->rows;
        if (tape->at > tape->room || e->n < 1 || n_cells < 1 || n_walls < 0) return -1;
        if (n_cells * 4 + e->n * (int64_t)(sizeof(insect) + sizeof(own_entry)) > tape->room - tape->at) return -1;
        e->insect = calloc((size_t)e->n, sizeof *e->insect);
        e->order = calloc((size_t)e->n, sizeof *e->order);
        e->cells = calloc((size_t)n_cells, sizeof *e->cells);
        if (!e->insect || !e->order || !e->cells) return -1;
    }
    pass(tape, e->insect, e->n * (int64_t)sizeof *e->insect);
    if (tape->read)
        for (int32_t i = 0; i < e->n; i++) e->insect[i].near.at = e->insect[i].close.at = NULL; /* copies of another program's pointers */
    for (int32_t i = 0; i < e->n; i++)
        if (pass_links(tape, &e->insect[i].near) || pass_links(tape, &e->insect[i].close)) return -1;
    pass(tape, e->order, e->n * (int64_t)sizeof *e->order);
    pass(tape, e->cells, n_cells * (int64_t)sizeof *e->cells);
    void *pairs = e->pairs, *events = e->events, *legs = e->legs;
    int status = pass_array(tape, &pairs, &e->n_pairs, &e->room_pairs, sizeof *e->pairs);
    e->pairs = pairs;
    if (status) return status;
    status = pass_array(tape, &events, &e->n_events, &e->room_events, sizeof *e->events);
    e->events = events;
    if (status) return status;
    status = pass_array(tape, &legs, &e->n_legs, &e->room_legs, sizeof *e->legs);
    e->legs = legs;
    if (status) return status;
    return tape->read && tape->at != tape->room ? -1 : 0;
}

/* Write a snapshot of at most `room` bytes; returns how many it takes. The walls are not in it: set them anew after loading. */
int64_t engine_save(const engine *e, uint8_t *place, int64_t room) {
    tape tape = {place, NULL, 0, place ? room : 0};
    pass_all(&tape, (engine *)e);
    return tape.at;
}

/* Returns NULL where the bytes are no snapshot of this build. */
engine *engine_load(const uint8_t *place, int64_t size) {
    engine *e = calloc(1, sizeof *e);
    tape tape = {NULL, place, 0, size};
    if (!e || pass_all(&tape, e) == 0) return e;
    engine_free(e);
    return NULL;
}
