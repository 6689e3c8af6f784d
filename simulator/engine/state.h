/* The engine's inside: what an insect is, and what its parts ask of each other. */
#ifndef BIOBOT_STATE_H
#define BIOBOT_STATE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "draws.h"
#include "engine.h"
#include "walls.h"

/* Streams of draws; 1 belongs to the places in arena.py. */
enum { LENGTH = 2, DIRECTION, STOP, REST, REST_KIND, EXIT, DEPART_1, DEPART_2, MISHAP, MISHAP_REST, DEATH, RESCUE, SIDE };

enum activity { WALK, FOLLOW, RESTING, STUCK, DEAD, HELD };
enum own_kind { OWN_LEG_END, OWN_CROSS, OWN_STOP, OWN_REST_END, OWN_EXIT, OWN_MISHAP, OWN_DEATH, OWN_SILENCE };
enum pair_kind { PAIR_END = 1, PAIR_SIGHT, PAIR_BEGIN, PAIR_PART, PAIR_TOUCH };

/* A root this close to the end of a leg, relative to the time, is that end. */
#define TIME_ROUNDING 1e-14
/* Directions tried in one place before an insect pauses there: reached only in corners of less than a thousandth of a radian. */
#define MOST_TRIES 20000
#define MOST_TURNS_AT_WALL 32
/* A wall follower goes round corners no sharper than this many margins of overhang; at sharper ones it turns back. */
#define MOST_OVERHANG 1000.0
#define SEARCH_SLACK (1.0 + 1e-6)

typedef struct {
    double met_s; /* since when in sight of each other */
    int32_t other;
    int32_t is_clear;
} link;

typedef struct {
    link *at;
    int32_t count, room;
} links;

typedef struct {
    double t0, x, y, vx, vy; /* the present leg */
    double t_end, t_free;    /* when it ends by itself; when its drawn length would be over without walls */
    double normal_x, normal_y; /* of what ends the leg; both 0 for nothing */
    double heading_x, heading_y;
    double stop_left, rest_left, exit_left, mishap_left, death_left; /* what each hazard has yet to use up, as of t_settled */
    double t_settled, t_own, silent_from;
    uint64_t id, leg_number, n_stops, n_bouts, n_mishaps, n_rescues;
    uint32_t version; /* of its motion */
    int32_t column, row, cell, next_in_cell, previous_in_cell;
    int32_t wall, sense, passed_wall;            /* followed; +1 along it; the one just left round a corner */
    int32_t next_wall, next_sense, next_passed;  /* when the leg ends */
    int32_t touched, touches_corner;
    int32_t activity, resume, is_held, is_silent, cause, own_kind;
    int32_t neighbours;
    int32_t place_in_heap;
    int32_t follows_walls; /* by command, whatever the law of all */
    int32_t unused; /* no bytes of chance in snapshots */
    links near, close;
} insect;

typedef struct {
    double t;
    int32_t kind, a, b;
    uint32_t version_a, version_b;
    int32_t unused; /* no bytes of chance in snapshots */
} pair_event;

/* An insect's place in the heap, with its t_own beside it: comparing must not fetch whole insects from memory. */
typedef struct {
    double t;
    int64_t i;
} own_entry;

struct engine {
    engine_config config;
    int32_t n, columns, rows, has_started;
    int32_t expected_walls; /* after loading a snapshot: how many it was taken with; else -1 */
    double now, cell, low_x, low_y;
    insect *insect;
    int32_t *cells;
    own_entry *order; /* heap of insects by t_own */
    pair_event *pairs;
    int64_t n_pairs, room_pairs;
    walls walls;
    int32_t *near_walls;
    int32_t room_near;
    engine_event *events;
    int64_t n_events, room_events;
    engine_leg *legs;
    int64_t n_legs, room_legs;
    int64_t n_steps;
    int64_t n_looks; /* at pairs, since the engine was made or loaded */
    int has_failed; /* memory ran out */
};

/* What a free leg that ends at a wall is followed by. */
static inline int law_of(const engine *e, const insect *one) { return one->follows_walls ? LAW_FOLLOW : e->config.wall_law; }

static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }

static inline double draw_exponential(const engine *e, const insect *one, int stream, uint64_t index) {
    return draws_exponential(draws_word(e->config.seed, one->id, (uint64_t)stream, index));
}

static inline double draw_uniform(const engine *e, const insect *one, int stream, uint64_t index) {
    return draws_uniform(draws_word(e->config.seed, one->id, (uint64_t)stream, index));
}

static inline void *grow(engine *e, void *place, int64_t *room, int64_t needed, size_t size) {
    if (needed <= *room) return place;
    int64_t wanted = *room ? *room * 2 : 1024;
    while (wanted < needed) wanted *= 2;
    void *larger = realloc(place, (size_t)wanted * size);
    if (!larger) {
        e->has_failed = 1;
        return place;
    }
    *room = wanted;
    return larger;
}

/* Two insects on their present legs, as seen from the later of the two legs' starts. */
typedef struct {
    double t_ref, stop;
    double x, y;   /* first minus second */
    double vx, vy;
    double speed_squared, nearest, miss;
} passage;

typedef void (*with_neighbour)(engine *e, int32_t i, int32_t j, double t);

/* schedule.c */
void tell(engine *e, engine_event event);
void tell_mode(engine *e, int32_t i, double t, int is_still, int cause);
void tell_end(engine *e, int32_t a, int32_t b, double met_s, double t);
void close_leg(engine *e, int32_t i, double t);
void sift(engine *e, int32_t i);
void expect(engine *e, double t, int kind, int32_t a, int32_t b);
pair_event take_pair(engine *e);
int is_walking(const insect *one);
void settle(engine *e, insect *one, double t);
void consider(insect *one, double t, int kind);
double crossing(double t, double t0, double place, double velocity, double low, double high);
void schedule(engine *e, int32_t i, double t);

/* pairs.c */
link *find_link(links *all, int32_t other);
link *add_link(engine *e, links *all, link one);
void drop_link(links *all, int32_t other);
double wrap(double distance, double period);
passage see_passage(const engine *e, const insect *a, const insect *b, double t);
int solve(const passage *p, double radius, double *begin, double *end);
void place_at(const insect *one, double t, double *x, double *y);
int is_in_sight(engine *e, const insect *a, const insect *b, const passage *p, double t, double limit, double *until);
void expect_encounter(engine *e, int32_t a, int32_t b, const passage *p, double t);
void expect_contact(engine *e, int32_t a, int32_t b, const passage *p, double t);
void evaluate(engine *e, int32_t i, int32_t j, double t);
int32_t cell_of(const engine *e, int32_t column, int32_t row);
void leave_cell(engine *e, int32_t i);
void enter_cell(engine *e, int32_t i);
void visit_cell(engine *e, int32_t i, int32_t column, int32_t row, double t, with_neighbour visit);
void visit_around(engine *e, int32_t i, double t, with_neighbour visit);
void go_on(engine *e, int32_t i, double t);

/* motion.c */
void rotate(double x, double y, double cosine, double sine, double *out_x, double *out_y);
void stand(engine *e, int32_t i, double t, double t_end);
void walk(engine *e, int32_t i, double t, double forced_x, double forced_y, double forced_length);
void follow(engine *e, int32_t i, double t);
void meet_wall(engine *e, int32_t i, double t);
void resume(engine *e, int32_t i, double t);

/* happenings.c */
void halt(engine *e, int32_t i, double t, int activity);
void fall_silent(engine *e, int32_t i, double t);
void depart(engine *e, int32_t i, double t);
void own_event(engine *e, int32_t i);
void pair_event_happens(engine *e, const pair_event *event);
void find_company(engine *e, int32_t i, int32_t j, double t);

#endif
