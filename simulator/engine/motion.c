/* Legs: how an insect goes on, in the open, at walls and along them. */
#include "state.h"

/* ---- legs ---- */

static double draw_length(const engine *e, const insect *one) {
    const engine_config *c = &e->config;
    uint64_t bits = draws_word(c->seed, one->id, LENGTH, one->leg_number);
    if (c->levy_exponent == 0.0) return c->leg_scale * draws_exponential(bits);
    /* Truncated power law, by inversion: P(L > l) falls as l^(1 - mu) from the shortest to the longest leg. */
    double power = c->levy_exponent - 1.0;
    double tail = draws_exp(-power * draws_log(c->longest_leg / c->leg_scale));
    return c->leg_scale * draws_exp(-draws_log(1.0 - draws_uniform(bits) * (1.0 - tail)) / power);
}

void rotate(double x, double y, double cosine, double sine, double *out_x, double *out_y) {
    *out_x = x * cosine - y * sine;
    *out_y = y * cosine + x * sine;
}

static void draw_direction(const engine *e, const insect *one, double *dx, double *dy) {
    const engine_config *c = &e->config;
    double u = draw_uniform(e, one, DIRECTION, one->leg_number), cosine, sine;
    if (one->normal_x != 0.0 || one->normal_y != 0.0) {
        if (law_of(e, one) == LAW_COSINE) {
            sine = 2.0 * u - 1.0;
            cosine = sqrt(1.0 - sine * sine);
        } else {
            draws_circle(0.5 * u - 0.25, &cosine, &sine);
        }
        rotate(one->normal_x, one->normal_y, cosine, sine, dx, dy);
    } else if (c->persistence > 0.0 && (one->heading_x != 0.0 || one->heading_y != 0.0)) {
        /* Wrapped Cauchy distribution of mean cosine rho: tan(turn / 2) = (1 - rho) / (1 + rho) tan(pi (u - 1/2)). */
        draws_circle(0.5 * (u - 0.5), &cosine, &sine);
        double half = (1.0 - c->persistence) / (1.0 + c->persistence) * (sine / cosine), square = half * half;
        rotate(one->heading_x, one->heading_y, (1.0 - square) / (1.0 + square), 2.0 * half / (1.0 + square), dx, dy);
    } else {
        draws_circle(u, dx, dy);
    }
}

static void mirror(const insect *one, double *dx, double *dy) {
    double into = one->heading_x * one->normal_x + one->heading_y * one->normal_y;
    *dx = one->heading_x - 2.0 * into * one->normal_x;
    *dy = one->heading_y - 2.0 * into * one->normal_y;
    double length = sqrt(*dx * *dx + *dy * *dy); /* rounding must not add up over many reflections */
    *dx /= length;
    *dy /= length;
}

static const int32_t NOTHING[2] = {-1, -1};

void stand(engine *e, int32_t i, double t, double t_end) {
    insect *one = &e->insect[i];
    one->vx = one->vy = 0.0;
    one->t0 = t;
    one->t_end = one->t_free = t_end;
    one->normal_x = one->normal_y = 0.0;
    go_on(e, i, t);
}

/* Begin a free leg at t. A forced direction and a forced length (0 for none) come first; where the way is blocked at once, no time passes
   and another direction is drawn. */
void walk(engine *e, int32_t i, double t, double forced_x, double forced_y, double forced_length) {
    insect *one = &e->insect[i];
    double speed = e->config.speed, dx, dy;
    for (int tries = 0; tries < MOST_TRIES; tries++) {
        int is_forced = tries == 0 && (forced_x != 0.0 || forced_y != 0.0);
        if (is_forced)
            dx = forced_x, dy = forced_y;
        else if (law_of(e, one) == LAW_MIRROR && (one->normal_x != 0.0 || one->normal_y != 0.0) && tries < MOST_TURNS_AT_WALL)
            mirror(one, &dx, &dy);
        else
            draw_direction(e, one, &dx, &dy);
        double length = forced_length > 0.0 && tries == 0 ? forced_length : draw_length(e, one);
        one->leg_number++;
        touch reach = walls_reach(&e->walls, one->x, one->y, dx, dy, length, NOTHING, NOTHING);
        int touches = reach.length < length;
        double t_end = t + least(length, reach.length) / speed;
        one->heading_x = dx;
        one->heading_y = dy;
        one->normal_x = touches ? reach.normal_x : 0.0;
        one->normal_y = touches ? reach.normal_y : 0.0;
        one->touched = touches ? reach.wall : -1;
        one->touches_corner = reach.is_corner;
        if (t_end > t) {
            one->activity = WALK;
            one->vx = speed * dx;
            one->vy = speed * dy;
            one->t0 = t;
            one->t_end = t_end;
            one->t_free = t + length / speed;
            go_on(e, i, t);
            return;
        }
    }
    one->activity = WALK;
    stand(e, i, t, t + e->config.leg_scale / speed);
}

static void leave_wall(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    one->normal_x = e->walls.wall[one->wall].normal_x;
    one->normal_y = e->walls.wall[one->wall].normal_y;
    walk(e, i, t, 0.0, 0.0, 0.0);
}

/* Begin a leg along the wall that is followed. At a corner of the arena the next wall stands in the way; round a corner of an obstacle the
   path goes by the point that has the margin from both walls. */
void follow(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    const wall *all = e->walls.wall;
    double speed = e->config.wall_speed, margin = e->walls.margin;
    for (int turns = 0; turns < MOST_TURNS_AT_WALL; turns++) {
        const wall *mine = &all[one->wall];
        int32_t following = one->sense > 0 ? mine->next : mine->previous;
        const wall *next = &all[following];
        double length = sqrt(mine->square), next_length = sqrt(next->square), sense = one->sense;
        double dx = sense * mine->along_x / length, dy = sense * mine->along_y / length;
        double next_dx = sense * next->along_x / next_length, next_dy = sense * next->along_y / next_length;
        double turn = sense * (dx * next_dy - dy * next_dx), straight = dx * next_dx + dy * next_dy;
        double corner_x = one->sense > 0 ? mine->end_x : mine->x, corner_y = one->sense > 0 ? mine->end_y : mine->y;
        double ahead = (corner_x - one->x) * dx + (corner_y - one->y) * dy;
        int sticks_out = turn <= 0.0; /* the corner of an obstacle, or none to speak of */
        double overhang = sticks_out ? margin * -turn / (1.0 + straight) : 0.0;
        int turns_back = sticks_out && !(overhang <= MOST_OVERHANG * margin);
        double limit = most(ahead + (turns_back ? 0.0 : overhang), 0.0);
        const int32_t faces[2] = {one->wall, one->passed_wall}, corners[2] = {one->wall, mine->next};
        touch reach = walls_reach(&e->walls, one->x, one->y, dx, dy, limit, faces, corners);
        if (reach.length < limit) {
            one->next_wall = reach.is_corner ? one->wall : reach.wall;
            one->next_sense = reach.is_corner ? -one->sense : one->sense;
            one->next_passed = -1;
        } else {
            one->next_wall = turns_back ? one->wall : following;
            one->next_sense = turns_back ? -one->sense : one->sense;
            one->next_passed = sticks_out && !turns_back ? one->wall : -1;
        }
        double t_end = t + least(limit, reach.length) / speed;
        one->heading_x = dx;
        one->heading_y = dy;
        if (t_end > t) {
            one->activity = FOLLOW;
            one->vx = speed * dx;
            one->vy = speed * dy;
            one->t0 = t;
            one->t_end = one->t_free = t_end;
            go_on(e, i, t);
            return;
        }
        one->wall = one->next_wall;
        one->sense = one->next_sense;
        one->passed_wall = one->next_passed;
    }
    leave_wall(e, i, t); /* wedged between walls */
}

/* A free leg has ended at a wall: go along it, to the side that the way there leant to. */
void meet_wall(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    const wall *all = e->walls.wall, *mine = &all[one->touched];
    double lean = one->heading_x * mine->along_x + one->heading_y * mine->along_y;
    one->exit_left = draw_exponential(e, one, EXIT, one->n_bouts);
    int forward = lean != 0.0 ? lean > 0.0 : draw_uniform(e, one, SIDE, one->n_bouts) < 0.5;
    one->n_bouts++;
    one->passed_wall = -1;
    one->wall = one->touched;
    one->sense = forward ? 1 : -1;
    if (!one->touches_corner) {
        follow(e, i, t);
        return;
    }
    /* A corner of an obstacle, met head-on: first to the point that has the margin from both its walls. */
    const wall *before = &all[mine->previous];
    double together = 1.0 + mine->normal_x * before->normal_x + mine->normal_y * before->normal_y, margin = e->walls.margin;
    double to_x = mine->x + margin * (mine->normal_x + before->normal_x) / together - one->x;
    double to_y = mine->y + margin * (mine->normal_y + before->normal_y) / together - one->y;
    double length = sqrt(to_x * to_x + to_y * to_y);
    one->next_wall = forward ? one->touched : mine->previous;
    one->next_passed = forward ? mine->previous : one->touched;
    one->next_sense = one->sense;
    if (!(length <= MOST_OVERHANG * margin)) {
        leave_wall(e, i, t);
        return;
    }
    if (t + length / e->config.wall_speed > t) {
        const int32_t faces[2] = {one->touched, mine->previous}, corners[2] = {one->touched, -1};
        touch reach = walls_reach(&e->walls, one->x, one->y, to_x / length, to_y / length, length, faces, corners);
        if (reach.length < length) {
            leave_wall(e, i, t);
            return;
        }
        one->activity = FOLLOW;
        one->vx = e->config.wall_speed * to_x / length;
        one->vy = e->config.wall_speed * to_y / length;
        one->t0 = t;
        one->t_end = one->t_free = t + length / e->config.wall_speed;
        go_on(e, i, t);
        return;
    }
    one->wall = one->next_wall;
    one->passed_wall = one->next_passed;
    follow(e, i, t);
}

void resume(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    one->normal_x = one->normal_y = 0.0;
    if (one->resume == FOLLOW)
        follow(e, i, t);
    else
        walk(e, i, t, 0.0, 0.0, 0.0);
}
