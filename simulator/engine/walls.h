/* Walls: how far a straight walk goes before it touches one, and which stand near a place. */
#ifndef BIOBOT_WALLS_H
#define BIOBOT_WALLS_H

#include <stdint.h>

/* One straight wall; the arena is on the left of the way from start to end. Every corner is the start of exactly one wall. */
typedef struct {
    double x, y;           /* start */
    double end_x, end_y;
    double along_x, along_y; /* end - start */
    double normal_x, normal_y; /* unit, into the arena */
    double square, slack;  /* squared length; margin over length */
    int32_t next, previous; /* along the same ring */
} wall;

/* All walls, and a grid of square cells that lists those near each. */
typedef struct {
    int32_t n;
    wall *wall;
    double margin;
    double low_x, low_y, cell;
    int32_t columns, rows;
    int32_t *first; /* of cell k: near[first[k]] .. near[first[k + 1] - 1] */
    int32_t *near;
} walls;

/* What a straight walk touches first. */
typedef struct {
    double length; /* infinite where nothing is in the way */
    double normal_x, normal_y;
    int32_t wall; /* whose face, or whose start corner; -1 for none */
    int32_t is_corner;
} touch;

/* Returns 0, or -1 where memory is lacking. Coordinates: n pairs each; previous: of each wall in its ring. */
int walls_build(walls *all, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin);
void walls_free(walls *all);

/* Walks of more than `longest` need not be told from endless ones. Two faces and two start corners can be left out (-1 for none). */
touch walls_reach(const walls *all, double x, double y, double dx, double dy, double longest, const int32_t *skip_face, const int32_t *skip_corner);

/* List walls whose boxes reach into a box; at most `room` of them; returns how many there are. */
int32_t walls_near(const walls *all, double x_min, double x_max, double y_min, double y_max, int32_t *found, int32_t room);

#endif
