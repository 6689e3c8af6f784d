/* Walls: see walls.h.

   A wall is the set of points within the margin of a segment: a strip before its face, and a disc around each corner. Ties go to faces
   before corners, then to the wall that comes first, so that the answer does not depend on how the grid was walked. */
#include "walls.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Up to this many walls, looking at each is faster than walking through the grid. */
#define FEW_WALLS 16
#define MOST_CELLS 4000000.0
#define DEEP (1.0 - 1e-6)

static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }

static int32_t clamp_cell(double position, int32_t count) {
    if (!(position > 0.0)) return 0;
    return position >= count ? count - 1 : (int32_t)position;
}

static int reaches_cell(const walls *all, const wall *one, int32_t column, int32_t row) {
    double half = 0.5 * all->cell, reach = half * 1.4142135623730952 + 4.0 * all->margin;
    double x = all->low_x + (column + 0.5) * all->cell - one->x, y = all->low_y + (row + 0.5) * all->cell - one->y;
    return fabs(x * one->normal_x + y * one->normal_y) <= reach;
}

static int fill_grid(walls *all) {
    double high_x = -INFINITY, high_y = -INFINITY, inflate = 4.0 * all->margin;
    all->low_x = all->low_y = INFINITY;
    for (int32_t k = 0; k < all->n; k++) {
        all->low_x = least(all->low_x, all->wall[k].x);
        all->low_y = least(all->low_y, all->wall[k].y);
        high_x = most(high_x, all->wall[k].x);
        high_y = most(high_y, all->wall[k].y);
    }
    double width = high_x - all->low_x, height = high_y - all->low_y;
    double wanted = least(MOST_CELLS, 2.0 * all->n + 1.0);
    all->cell = most(sqrt(width * height / wanted), most(width, height) / 20000.0);
    all->low_x -= inflate;
    all->low_y -= inflate;
    all->columns = (int32_t)((width + 2.0 * inflate) / all->cell) + 1;
    all->rows = (int32_t)((height + 2.0 * inflate) / all->cell) + 1;
    size_t cells = (size_t)all->columns * (size_t)all->rows;
    all->first = calloc(cells + 1, sizeof *all->first);
    if (!all->first) return -1;
    for (int pass = 0; pass < 2; pass++) {
        for (int32_t k = 0; k < all->n; k++) {
            const wall *one = &all->wall[k];
            int32_t left = clamp_cell((least(one->x, one->end_x) - inflate - all->low_x) / all->cell, all->columns);
            int32_t right = clamp_cell((most(one->x, one->end_x) + inflate - all->low_x) / all->cell, all->columns);
            int32_t bottom = clamp_cell((least(one->y, one->end_y) - inflate - all->low_y) / all->cell, all->rows);
            int32_t top = clamp_cell((most(one->y, one->end_y) + inflate - all->low_y) / all->cell, all->rows);
            for (int32_t row = bottom; row <= top; row++)
                for (int32_t column = left; column <= right; column++) {
                    if (!reaches_cell(all, one, column, row)) continue;
                    size_t place = (size_t)row * (size_t)all->columns + (size_t)column;
                    if (pass == 0)
                        all->first[place + 1]++;
                    else
                        all->near[all->first[place]++] = k;
                }
        }
        if (pass == 0) {
            for (size_t k = 0; k < cells; k++) all->first[k + 1] += all->first[k];
            all->near = malloc(sizeof *all->near * (size_t)(all->first[cells] + 1));
            if (!all->near) return -1;
        } else {
            memmove(all->first + 1, all->first, cells * sizeof *all->first); /* filling moved every first to its end */
            all->first[0] = 0;
        }
    }
    return 0;
}

int walls_build(walls *all, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin) {
    memset(all, 0, sizeof *all);
    all->n = n;
    all->margin = margin;
    if (n == 0) return 0;
    all->wall = calloc((size_t)n, sizeof *all->wall);
    if (!all->wall) return -1;
    for (int32_t k = 0; k < n; k++) {
        wall *one = &all->wall[k];
        one->x = start[2 * k];
        one->y = start[2 * k + 1];
        one->end_x = end[2 * k];
        one->end_y = end[2 * k + 1];
        one->along_x = one->end_x - one->x;
        one->along_y = one->end_y - one->y;
        one->normal_x = normal[2 * k];
        one->normal_y = normal[2 * k + 1];
        one->square = one->along_x * one->along_x + one->along_y * one->along_y;
        one->slack = margin / sqrt(one->square);
        one->previous = previous[k];
        all->wall[previous[k]].next = k;
    }
    return fill_grid(all);
}

void walls_free(walls *all) {
    free(all->wall);
    free(all->first);
    free(all->near);
    memset(all, 0, sizeof *all);
}

typedef struct {
    double x, y, dx, dy;
    double face_length, corner_length;
    int32_t face, corner;
} ray;

/* How far to the face of a wall; infinite where the ray does not meet it. */
static double length_to_face(const walls *all, const wall *one, const ray *from) {
    double px = from->x - one->x, py = from->y - one->y;
    double height = px * one->normal_x + py * one->normal_y;
    double climb = from->dx * one->normal_x + from->dy * one->normal_y;
    if (!(climb < 0.0) || !(height >= 0.0)) return INFINITY;
    double length = (height - all->margin) / -climb;
    if (!(length > 0.0)) length = 0.0;
    /* One margin further at both ends, so that a grazing ray cannot slip between a face and its corner by rounding. Not so from well below
       the margin: beyond an end the disc alone is in the way there, and a face would hold an insect in a gap narrower than two margins. */
    double slack = height < DEEP * all->margin ? 0.0 : one->slack;
    double share = ((px + length * from->dx) * one->along_x + (py + length * from->dy) * one->along_y) / one->square;
    return share >= -slack && share <= 1.0 + slack ? length : INFINITY;
}

/* How far to the disc around the start of a wall. */
static double length_to_corner(const walls *all, const wall *one, const ray *from) {
    double px = from->x - one->x, py = from->y - one->y;
    double approach = px * from->dx + py * from->dy, aside = px * from->dy - py * from->dx;
    if (!(fabs(aside) < all->margin) || !(approach < 0.0)) return INFINITY;
    double inside = all->margin * all->margin - aside * aside;
    double length = -approach - sqrt(inside > 0.0 ? inside : 0.0);
    return length > 0.0 ? length : 0.0;
}

static void look_at(const walls *all, int32_t k, ray *from, const int32_t *skip_face, const int32_t *skip_corner) {
    const wall *one = &all->wall[k];
    if (k != skip_face[0] && k != skip_face[1]) {
        double length = length_to_face(all, one, from);
        if (length < from->face_length || (length == from->face_length && k < from->face)) {
            from->face_length = length;
            from->face = k;
        }
    }
    if (k != skip_corner[0] && k != skip_corner[1]) {
        double length = length_to_corner(all, one, from);
        if (length < from->corner_length || (length == from->corner_length && k < from->corner)) {
            from->corner_length = length;
            from->corner = k;
        }
    }
}

static void walk_grid(const walls *all, ray *from, double longest, const int32_t *skip_face, const int32_t *skip_corner) {
    int32_t column = clamp_cell((from->x - all->low_x) / all->cell, all->columns);
    int32_t row = clamp_cell((from->y - all->low_y) / all->cell, all->rows);
    int32_t step_x = from->dx > 0.0 ? 1 : -1, step_y = from->dy > 0.0 ? 1 : -1;
    for (;;) {
        int32_t place = row * all->columns + column;
        for (int32_t k = all->first[place]; k < all->first[place + 1]; k++) look_at(all, all->near[k], from, skip_face, skip_corner);
        double edge_x = all->low_x + (column + (step_x > 0)) * all->cell, edge_y = all->low_y + (row + (step_y > 0)) * all->cell;
        double leaves_x = from->dx != 0.0 ? (edge_x - from->x) / from->dx : INFINITY;
        double leaves_y = from->dy != 0.0 ? (edge_y - from->y) / from->dy : INFINITY;
        double leaves = least(leaves_x, leaves_y);
        if (leaves > longest || least(from->face_length, from->corner_length) < leaves) return;
        if (leaves_x <= leaves_y)
            column += step_x;
        else
            row += step_y;
        if (column < 0 || column >= all->columns || row < 0 || row >= all->rows) return;
    }
}

touch walls_reach(const walls *all, double x, double y, double dx, double dy, double longest, const int32_t *skip_face, const int32_t *skip_corner) {
    ray from = {x, y, dx, dy, INFINITY, INFINITY, INT32_MAX, INT32_MAX};
    if (all->n <= FEW_WALLS)
        for (int32_t k = 0; k < all->n; k++) look_at(all, k, &from, skip_face, skip_corner);
    else
        walk_grid(all, &from, longest, skip_face, skip_corner);
    touch found = {INFINITY, 0.0, 0.0, -1, 0};
    if (from.corner_length < from.face_length) {
        double touch_x = x - all->wall[from.corner].x + from.corner_length * dx, touch_y = y - all->wall[from.corner].y + from.corner_length * dy;
        double distance = sqrt(touch_x * touch_x + touch_y * touch_y);
        found = (touch){from.corner_length, touch_x / distance, touch_y / distance, from.corner, 1};
    } else if (from.face_length < INFINITY) {
        const wall *one = &all->wall[from.face];
        found = (touch){from.face_length, one->normal_x, one->normal_y, from.face, 0};
    }
    return found;
}

int32_t walls_near(const walls *all, double x_min, double x_max, double y_min, double y_max, int32_t *found, int32_t room) {
    int32_t count = 0;
    if (all->n <= FEW_WALLS) {
        for (int32_t k = 0; k < all->n; k++) {
            const wall *one = &all->wall[k];
            if (x_min <= most(one->x, one->end_x) && x_max >= least(one->x, one->end_x) && y_min <= most(one->y, one->end_y) && y_max >= least(one->y, one->end_y)) {
                if (count < room) found[count] = k;
                count++;
            }
        }
        return count;
    }
    int32_t left = clamp_cell((x_min - all->low_x) / all->cell, all->columns), right = clamp_cell((x_max - all->low_x) / all->cell, all->columns);
    int32_t bottom = clamp_cell((y_min - all->low_y) / all->cell, all->rows), top = clamp_cell((y_max - all->low_y) / all->cell, all->rows);
    for (int32_t row = bottom; row <= top; row++)
        for (int32_t column = left; column <= right; column++) {
            int32_t place = row * all->columns + column;
            for (int32_t at = all->first[place]; at < all->first[place + 1]; at++) {
                const wall *one = &all->wall[all->near[at]];
                if (!(x_min <= most(one->x, one->end_x) && x_max >= least(one->x, one->end_x) && y_min <= most(one->y, one->end_y) && y_max >= least(one->y, one->end_y)))
                    continue;
                int32_t known = 0;
                while (known < count && known < room && found[known] != all->near[at]) known++;
                if (known < count && known < room) continue; /* listed by a cell before */
                if (count < room) found[count] = all->near[at];
                count++;
            }
        }
    return count;
}
