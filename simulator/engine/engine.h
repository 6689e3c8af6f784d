/* The engine of the simulator: insects on straight legs between walls, from event to event. See engine.c and the interface in binding.py. */
#ifndef BIOBOT_ENGINE_H
#define BIOBOT_ENGINE_H

#include <stdint.h>

#pragma GCC visibility push(default)

enum wall_law { LAW_UNIFORM, LAW_COSINE, LAW_MIRROR, LAW_FOLLOW };

/* Lengths in the arena's unit, hazards per second, times in seconds, angles in radians. A hazard or radius of 0 switches its effect off. */
typedef struct {
    uint64_t seed;
    double speed, wall_speed;
    double leg_scale;     /* mean of an exponential leg, or shortest leg of a power law */
    double levy_exponent; /* 0: legs are exponential */
    double longest_leg;
    double persistence; /* mean cosine of the turning angle */
    double detection, contact;
    double stop_open, stop_wall;
    double rest_short, rest_long, share_long;
    double social_stop, social_rest; /* per neighbour within contact */
    double exit_wall, departure_median, departure_log_sd;
    double mishap, mishap_rest, rescue;
    double death;
    double period; /* side of a torus; 0: none */
    int32_t wall_law;
    int32_t contact_turns;
} engine_config;

enum event_kind { EVENT_MODE, EVENT_END, EVENT_BEGIN, EVENT_SILENCED };

typedef struct {
    double t_s;
    double met_s;       /* of an end: when the encounter began */
    int32_t kind;       /* event_kind, or -1 for one that was taken back */
    int32_t first, second; /* rows; of a mode: row, then 1 for standing still */
    int32_t cause;      /* of a mode: 1 for a command */
} engine_event;

typedef struct {
    double t_start_s, t_end_s, x, y, vx, vy;
    int64_t row;
} engine_leg;

typedef struct engine engine;

engine *engine_create(const engine_config *config, int32_t n, const uint64_t *ids, const double *xy, const double *silent_from_s);
void engine_free(engine *e);
int engine_set_walls(engine *e, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin);
int engine_start(engine *e, double low_x, double low_y, double high_x, double high_y);
int engine_advance(engine *e, double until_s, int64_t most_work);
int engine_replace_walls(engine *e, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin,
                         const double *xy);
int engine_stop(engine *e, int32_t row, int32_t cause);
int engine_go(engine *e, int32_t row, int32_t cause);
int engine_turn(engine *e, int32_t row, double turns, double distance);
int engine_follow_walls(engine *e, int32_t row, int32_t follows);
int engine_silence(engine *e, int32_t row);
void engine_modes(const engine *e, int32_t *mode, int32_t *cause);
void engine_current_legs(const engine *e, engine_leg *legs);
int64_t engine_take_events(engine *e, const engine_event **events);
int64_t engine_take_legs(engine *e, const engine_leg **legs);
int64_t engine_open(const engine *e, engine_event *found, int64_t room);
int64_t engine_steps(const engine *e);
int64_t engine_work(const engine *e);
double engine_now(const engine *e);
int64_t engine_save(const engine *e, uint8_t *place, int64_t room);
engine *engine_load(const uint8_t *place, int64_t size);
int64_t engine_layout(void);
int64_t engine_sources(void);
int32_t engine_count(const engine *e);

#pragma GCC visibility pop

#endif
