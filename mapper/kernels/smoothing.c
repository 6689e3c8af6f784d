/* Means over nearest rows: exact k-nearest-neighbour search among rows of many columns that spread along few directions.

   Each row has a shadow: its place along the few directions given, and how far it is from all of them; in single precision, in shares of
   the furthest row. No two rows are nearer than their shadows. The rows are halved again and again at the median of one coordinate of
   their shadows, until a leaf holds no more than a slot. Node 1 is the root, the children of node i are 2i and 2i + 1, and all leaves are
   `depth` below the root: where a node begins and ends follows from its number. */
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Coordinates of a shadow, and how many shadows of a leaf are measured at a time; a slot is a multiple of it. */
enum { WIDTH = 8, LOOKED_AT = 64, FEW = 64, DIGIT = 11 };

/* Beyond all rounding: of a shadow, as a share of the furthest row, and of a sum of squares in single precision. */
static const double BLUR = 2e-6, SLACK = 1 + 1e-5;

typedef struct {
  double key; /* a squared distance, or a coordinate */
  int32_t at;
} ranked;

static int is_before(ranked a, ranked b) { return a.key < b.key || (a.key == b.key && a.at < b.at); }

/* Put what sorting would put at `rank` there, nothing later before it and nothing earlier after. */
static void select_ranked(ranked *items, int32_t n, int32_t rank) {
  int32_t low = 0, high = n - 1;
  while (low < high) {
    ranked pivot = items[low + (high - low) / 2];
    int32_t i = low, j = high;
    while (i <= j) {
      while (is_before(items[i], pivot)) i++;
      while (is_before(pivot, items[j])) j--;
      if (i <= j) {
        ranked swap = items[i];
        items[i++] = items[j];
        items[j--] = swap;
      }
    }
    if (rank <= j) high = j;
    else if (rank >= i) low = i;
    else return;
  }
}

static int32_t begin_of(int32_t n, int32_t depth, int32_t place) { return (int32_t)(((int64_t)n * place) >> depth); }

static int32_t padded(int32_t n_columns) { return (n_columns + 3) / 4 * 4; }

/* The coordinate in which some shadows, taken at even steps, spread most. */
static int32_t find_widest(const float *shadows, const int32_t *order, int32_t n) {
  int32_t n_looked = n < LOOKED_AT ? n : LOOKED_AT, widest = 0;
  float most = -1;
  for (int32_t k = 0; k < WIDTH; k++) {
    float low = INFINITY, high = -INFINITY;
    for (int32_t s = 0; s < n_looked; s++) {
      float x = shadows[(int64_t)order[(int64_t)n * s / n_looked] * WIDTH + k];
      low = x < low ? x : low;
      high = x > high ? x : high;
    }
    if (high - low > most) {
      most = high - low;
      widest = k;
    }
  }
  return widest;
}

/* Fill the shadows (n * WIDTH); `rest` is room for a row. Returns the distance of the furthest row from the centre, 1 if all are there. */
static double cast_shadows(const double *rows, int32_t n, int32_t n_columns, const double *centre, const double *axes, int32_t n_axes,
                           double *rest, float *shadows) {
  double furthest = 0;
  for (int32_t i = 0; i < n; i++) {
    double square = 0;
    for (int32_t c = 0; c < n_columns; c++) {
      double d = rows[(int64_t)i * n_columns + c] - centre[c];
      square += d * d;
    }
    furthest = square > furthest ? square : furthest;
  }
  double scale = furthest > 0 ? sqrt(furthest) : 1;
  for (int32_t i = 0; i < n; i++) {
    float *shadow = shadows + (int64_t)i * WIDTH;
    double square = 0;
    for (int32_t c = 0; c < n_columns; c++) rest[c] = (rows[(int64_t)i * n_columns + c] - centre[c]) / scale;
    for (int32_t a = 0; a < n_axes; a++) {
      double along = 0;
      for (int32_t c = 0; c < n_columns; c++) along += rest[c] * axes[(int64_t)a * n_columns + c];
      for (int32_t c = 0; c < n_columns; c++) rest[c] -= along * axes[(int64_t)a * n_columns + c];
      shadow[a] = (float)along;
    }
    for (int32_t c = 0; c < n_columns; c++) square += rest[c] * rest[c];
    shadow[n_axes] = (float)sqrt(square);
    for (int32_t k = n_axes + 1; k < WIDTH; k++) shadow[k] = 0;
  }
  return scale;
}

/* Put all rows in the order of the leaves. */
static void sort_into_leaves(const float *shadows, int32_t n, int32_t depth, ranked *items, int32_t *order) {
  for (int32_t i = 0; i < n; i++) order[i] = i;
  for (int32_t level = 0; level < depth; level++)
    for (int32_t place = 0; place < 1 << level; place++) {
      int32_t begin = begin_of(n, level, place), end = begin_of(n, level, place + 1), middle = begin_of(n, level + 1, 2 * place + 1);
      int32_t column = find_widest(shadows, order + begin, end - begin);
      for (int32_t i = begin; i < end; i++) items[i] = (ranked){shadows[(int64_t)order[i] * WIDTH + column], order[i]};
      select_ranked(items + begin, end - begin, middle - begin);
      for (int32_t i = begin; i < end; i++) order[i] = items[i].at;
    }
}

/* Lay out the shadows of each leaf, coordinate by coordinate, and find the lowest and highest of each coordinate in each node. */
static void fill_leaves(const float *shadows, int32_t n, int32_t depth, int32_t slot, const int32_t *order, float *leaves, float *boxes) {
  int32_t n_leaves = 1 << depth;
  for (int32_t leaf = 0; leaf < n_leaves; leaf++) {
    int32_t begin = begin_of(n, depth, leaf), size = begin_of(n, depth, leaf + 1) - begin;
    float *block = leaves + (int64_t)leaf * slot * WIDTH, *low = boxes + (int64_t)(n_leaves + leaf) * 2 * WIDTH, *high = low + WIDTH;
    for (int32_t k = 0; k < WIDTH; k++) {
      low[k] = INFINITY;
      high[k] = -INFINITY;
      for (int32_t i = 0; i < slot; i++) {
        float x = i < size ? shadows[(int64_t)order[begin + i] * WIDTH + k] : INFINITY;
        block[(int64_t)k * slot + i] = x;
        if (i < size && x < low[k]) low[k] = x;
        if (i < size && x > high[k]) high[k] = x;
      }
    }
  }
  for (int32_t node = n_leaves - 1; node > 0; node--) {
    float *box = boxes + (int64_t)node * 2 * WIDTH;
    const float *one = box + (int64_t)node * 2 * WIDTH, *other = one + 2 * WIDTH;
    for (int32_t k = 0; k < WIDTH; k++) {
      box[k] = one[k] < other[k] ? one[k] : other[k];
      box[WIDTH + k] = one[WIDTH + k] > other[WIDTH + k] ? one[WIDTH + k] : other[WIDTH + k];
    }
  }
}

/* Order n rows by the leaves of a tree.

   `axes` (n_axes * n_columns, n_axes below WIDTH) are orthonormal directions, `centre` (n_columns) any place among the rows. Filled are
   `order`, the rows themselves in that order, padded to whole vectors (`sorted`), their shadows by leaf (`leaves`), the boxes of all nodes,
   lowest before highest (`boxes`), and the distance of the furthest row from the centre (`scale`). */
KERNEL int plant_tree(const double *rows, int32_t n, int32_t n_columns, int32_t depth, int32_t slot, const double *centre,
                      const double *axes, int32_t n_axes, int32_t *order, double *sorted, float *leaves, float *boxes, double *scale) {
  ranked *items = malloc((size_t)n * sizeof *items);
  float *shadows = malloc((size_t)n * WIDTH * sizeof *shadows);
  double *rest = malloc((size_t)n_columns * sizeof *rest);
  int outcome = items && shadows && rest ? 0 : NO_MEMORY;
  if (outcome == 0) {
    *scale = cast_shadows(rows, n, n_columns, centre, axes, n_axes, rest, shadows);
    sort_into_leaves(shadows, n, depth, items, order);
    fill_leaves(shadows, n, depth, slot, order, leaves, boxes);
    int32_t stride = padded(n_columns);
    for (int32_t i = 0; i < n; i++) {
      double *row = sorted + (int64_t)i * stride;
      memcpy(row, rows + (int64_t)order[i] * n_columns, (size_t)n_columns * sizeof *row);
      for (int32_t c = n_columns; c < stride; c++) row[c] = 0;
    }
  }
  free(items);
  free(shadows);
  free(rest);
  return outcome;
}

/* Squared distance from a shadow to a box of shadows. */
TWICE static float to_box(const float *shadow, const float *box) {
  float square[WIDTH];
  for (int32_t k = 0; k < WIDTH; k++) {
    float below = box[k] - shadow[k], above = shadow[k] - box[WIDTH + k];
    float gap = below > above ? below : above;
    gap = gap > 0 ? gap : 0;
    square[k] = gap * gap;
  }
  return ((square[0] + square[4]) + (square[2] + square[6])) + ((square[1] + square[5]) + (square[3] + square[7]));
}

/* Squared distances from a shadow to all of a leaf. */
TWICE static void to_leaf(const float *shadow, const float *block, int32_t slot, float *squares) {
  for (int32_t at = 0; at < slot; at += WIDTH) {
    float sum[WIDTH] = {0};
    for (int32_t k = 0; k < WIDTH; k++)
      for (int32_t j = 0; j < WIDTH; j++) {
        float d = block[(int64_t)k * slot + at + j] - shadow[k];
        sum[j] += d * d;
      }
    memcpy(squares + at, sum, sizeof sum);
  }
}

/* Squared distance between rows: every fourth column goes to one of four sums, as in the plain way, so that both are rounded alike. */
TWICE static double to_row(const double *a, const double *b, int32_t stride) {
  double sum[4] = {0, 0, 0, 0};
  for (int32_t k = 0; k < stride; k += 4)
    for (int32_t j = 0; j < 4; j++) sum[j] += (a[k + j] - b[k + j]) * (a[k + j] - b[k + j]);
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

typedef struct {
  const int32_t *order;
  const double *sorted;
  const float *leaves, *boxes;
  double scale;
  int32_t n, stride, depth, slot;
  ranked *found; /* room for all that is found between two cuts */
  int32_t room;
  float *squares; /* of one leaf */
} tree;

/* What the squared distance of a shadow must not exceed for its row to be within a squared distance. */
static float shadow_of(double bound, double scale) {
  double reach = sqrt(bound) / scale + BLUR;
  return (float)(reach * reach * SLACK);
}

/* Find the k rows nearest to one, by distance, then by their numbers: found[0 .. k - 1], in no order. None is further than
   `bound`, a squared distance. Returns that of the furthest of them. */
static double find_nearest(const tree *t, const double *row, const float *shadow, int32_t k, double bound) {
  struct {
    float square;
    int32_t node;
  } waiting[64];
  int32_t n_waiting = 1, n_found = 0, n_leaves = 1 << t->depth;
  float limit = shadow_of(bound, t->scale);
  waiting[0].square = 0;
  waiting[0].node = 1;
  while (n_waiting > 0) {
    int32_t node = waiting[--n_waiting].node;
    float square = waiting[n_waiting].square;
    while (square <= limit && node < n_leaves) {
      int32_t near = 2 * node, far = near + 1;
      float to_near = to_box(shadow, t->boxes + (int64_t)near * 2 * WIDTH), to_far = to_box(shadow, t->boxes + (int64_t)far * 2 * WIDTH);
      int is_swapped = to_far < to_near;
      node = is_swapped ? far : near;
      square = is_swapped ? to_far : to_near;
      waiting[n_waiting].square = is_swapped ? to_near : to_far;
      waiting[n_waiting].node = is_swapped ? near : far;
      n_waiting += waiting[n_waiting].square <= limit;
    }
    if (square > limit) continue;
    int32_t leaf = node - n_leaves, begin = begin_of(t->n, t->depth, leaf), size = begin_of(t->n, t->depth, leaf + 1) - begin;
    to_leaf(shadow, t->leaves + (int64_t)leaf * t->slot * WIDTH, t->slot, t->squares);
    for (int32_t i = 0; i < size; i++) {
      if (t->squares[i] > limit) continue;
      double d = to_row(row, t->sorted + (int64_t)(begin + i) * t->stride, t->stride);
      if (d <= bound) t->found[n_found++] = (ranked){d, t->order[begin + i]};
    }
    if (n_found + t->slot > t->room) {
      select_ranked(t->found, n_found, k - 1);
      n_found = k;
      bound = t->found[k - 1].key;
      limit = shadow_of(bound, t->scale);
    }
  }
  select_ranked(t->found, n_found, k - 1);
  return t->found[k - 1].key;
}

/* Sort numbers below `limit`, digit by digit; `other` is room for as many. */
static void sort_many(int32_t *numbers, int32_t *other, int32_t n, int32_t limit) {
  for (int32_t shift = 0; shift < 32 && limit >> shift > 0; shift += DIGIT) {
    int32_t starts[(1 << DIGIT) + 1] = {0};
    for (int32_t i = 0; i < n; i++) starts[((numbers[i] >> shift) & ((1 << DIGIT) - 1)) + 1]++;
    for (int32_t d = 0; d < 1 << DIGIT; d++) starts[d + 1] += starts[d];
    for (int32_t i = 0; i < n; i++) other[starts[(numbers[i] >> shift) & ((1 << DIGIT) - 1)]++] = numbers[i];
    memcpy(numbers, other, (size_t)n * sizeof *numbers);
  }
}

static void sort_few(int32_t *numbers, int32_t n) {
  for (int32_t i = 1; i < n; i++) {
    int32_t number = numbers[i], at = i;
    for (; at > 0 && numbers[at - 1] > number; at--) numbers[at] = numbers[at - 1];
    numbers[at] = number;
  }
}

/* Average the k rows nearest to each of the leaves first .. last - 1, itself among them. Rows are added in the order of their numbers, so
   that the sum is rounded as the plain way rounds it. */
KERNEL int average_nearest(const double *rows, int32_t n, int32_t n_columns, int32_t depth, int32_t slot, const int32_t *order,
                           const double *sorted, const float *leaves, const float *boxes, double scale, int32_t k, int32_t first,
                           int32_t last, double *means) {
  int32_t stride = padded(n_columns), room = k + k / 2 + slot;
  ranked *found = malloc((size_t)room * sizeof *found);
  float *squares = malloc((size_t)slot * sizeof *squares);
  int32_t *nearest = malloc(2 * (size_t)k * sizeof *nearest);
  int outcome = found && squares && nearest ? 0 : NO_MEMORY;
  tree t = {order, sorted, leaves, boxes, scale, n, stride, depth, slot, found, room, squares};
  const double *before = NULL, *mean_before = NULL;
  double furthest = INFINITY;
  for (int32_t leaf = first; outcome == 0 && leaf < last; leaf++) {
    int32_t begin = begin_of(n, depth, leaf), end = begin_of(n, depth, leaf + 1);
    for (int32_t i = begin; i < end; i++) {
      const double *row = sorted + (int64_t)i * stride;
      double *mean = means + (int64_t)order[i] * n_columns, bound = INFINITY;
      if (before) {
        double step = to_row(row, before, stride);
        if (step == 0) { /* many encounters have the very profile of a landmark */
          memcpy(mean, mean_before, (size_t)n_columns * sizeof *mean);
          continue;
        }
        /* The k nearest to the row before are no further from this one than they are from that, and that from this. */
        double reach = (sqrt(furthest) + sqrt(step)) * (1 + 1e-9);
        bound = reach * reach;
      }
      float shadow[WIDTH];
      for (int32_t c = 0; c < WIDTH; c++) shadow[c] = leaves[((int64_t)leaf * WIDTH + c) * slot + i - begin];
      furthest = find_nearest(&t, row, shadow, k, bound);
      for (int32_t j = 0; j < k; j++) nearest[j] = found[j].at;
      if (k <= FEW) sort_few(nearest, k);
      else sort_many(nearest, nearest + k, k, n);
      memset(mean, 0, (size_t)n_columns * sizeof *mean);
      for (int32_t j = 0; j < k; j++) {
        const double *other = rows + (int64_t)nearest[j] * n_columns;
        for (int32_t c = 0; c < n_columns; c++) mean[c] += other[c];
      }
      for (int32_t c = 0; c < n_columns; c++) mean[c] /= k;
      before = row;
      mean_before = mean;
    }
  }
  free(found);
  free(squares);
  free(nearest);
  return outcome;
}
