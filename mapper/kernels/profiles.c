/* Landmark profiles: their brackets, and maxmin subsampling by the distance between them. A profile is a row of n_places numbers. */
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { NORM_MAX = 0, NORM_RMS = 1 };

/* Put the number that sorting would put at `rank` there, none larger before it and none smaller after. */
static void select_rank(double *values, int32_t n, int32_t rank) {
  int32_t low = 0, high = n - 1;
  while (low < high) {
    double pivot = values[low + (high - low) / 2];
    int32_t i = low, j = high;
    while (i <= j) {
      while (values[i] < pivot) i++;
      while (values[j] > pivot) j--;
      if (i <= j) {
        double swap = values[i];
        values[i++] = values[j];
        values[j--] = swap;
      }
    }
    if (rank <= j) high = j;
    else if (rank >= i) low = i;
    else return;
  }
}

static double find_median(double *values, int32_t n) {
  select_rank(values, n, n / 2);
  if (n % 2) return values[n / 2];
  double below = values[0];
  for (int32_t i = 1; i < n / 2; i++) below = values[i] > below ? values[i] : below;
  return (below + values[n / 2]) / 2;
}

/* For one row: the shortest detour over another place, less what that place is away. Padded to whole vectors. */
TWICE static void find_detours(const double *row, int32_t n_places, const double *between, int32_t stride, double *detour) {
  for (int32_t k = 0; k < stride; k++) detour[k] = INFINITY;
  for (int32_t m = 0; m < n_places; m++) {
    const double *apart = between + (int64_t)m * stride;
    for (int32_t k = 0; k < stride; k++) {
      double d = row[m] - apart[k];
      detour[k] = d < detour[k] ? d : detour[k];
    }
  }
}

/* Move every time to the middle of its bounds, in place; `doubt` is the median half gap. `between` (n_places * n_places): times between the places. */
KERNEL int bracket(double *times, int64_t n_rows, int32_t n_places, const double *between, double *doubt) {
  int32_t stride = (n_places + 3) / 4 * 4;
  double *apart = malloc((size_t)n_places * (size_t)stride * sizeof *apart), *detour = malloc((size_t)stride * sizeof *detour),
         *half = malloc((size_t)stride * sizeof *half);
  int outcome = apart && detour && half ? 0 : NO_MEMORY;
  if (outcome == 0) {
    for (int32_t m = 0; m < n_places; m++)
      for (int32_t k = 0; k < stride; k++) apart[(int64_t)m * stride + k] = k == m || k >= n_places ? -INFINITY : between[(int64_t)k * n_places + m];
    for (int64_t i = 0; i < n_rows; i++) {
      double *row = times + i * n_places;
      find_detours(row, n_places, apart, stride, detour);
      for (int32_t k = 0; k < n_places; k++) half[k] = n_places > 1 ? (row[k] + detour[k]) / 2 : 0;
      for (int32_t k = 0; k < n_places; k++) row[k] -= half[k];
      doubt[i] = find_median(half, n_places);
    }
  }
  free(apart);
  free(detour);
  free(half);
  return outcome;
}

TWICE static double largest_difference(const double *a, const double *b, int32_t n) {
  double largest = 0;
  for (int32_t i = 0; i < n; i++) {
    double d = fabs(a[i] - b[i]);
    largest = d > largest ? d : largest;
  }
  return largest;
}

/* In the order of the places, so that it is rounded as the plain way rounds it. */
static double mean_square_difference(const double *a, const double *b, int32_t n) {
  double sum = 0;
  for (int32_t i = 0; i < n; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sqrt(sum / n);
}

static double compare(const double *a, const double *b, int32_t n, int32_t norm) {
  return norm == NORM_MAX ? largest_difference(a, b, n) : mean_square_difference(a, b, n);
}

/* Pick up to n_points rows, each the furthest from those before it, beginning with the first; ties go to the earlier.

   A row nearer to its pick than half the way from there to a new pick is not measured: the triangle inequality says that the new one is no
   nearer. Returns how many were picked (none of no rows, with radius 0), or a negative number. */
KERNEL int32_t pick_profiles(const double *profiles, int64_t n_rows, int32_t n_places, int32_t norm, int32_t n_points, int64_t *picks,
                             double *distances, double *cover_radius) {
  double *nearest = malloc(((size_t)n_rows + 1) * sizeof *nearest), *apart = malloc(((size_t)n_points + 1) * sizeof *apart);
  int32_t *owner = malloc(((size_t)n_rows + 1) * sizeof *owner);
  int32_t n_picks = nearest && owner && apart ? 0 : NO_MEMORY;
  /* Beyond all rounding of a distance. */
  const double twice = 2 * (1 + 1e-9);
  int64_t furthest = 0;
  double radius = n_rows > 0 ? INFINITY : 0;
  for (int64_t i = 0; n_picks == 0 && i < n_rows; i++) {
    nearest[i] = INFINITY;
    owner[i] = 0;
  }
  while (n_picks >= 0 && n_picks < n_points && radius > 0) {
    const double *pick = profiles + furthest * n_places;
    for (int32_t j = 0; j < n_picks; j++) {
      apart[j] = compare(pick, profiles + picks[j] * n_places, n_places, norm);
      distances[(int64_t)n_picks * n_points + j] = distances[(int64_t)j * n_points + n_picks] = apart[j];
    }
    apart[n_picks] = 0;
    picks[n_picks] = furthest;
    radius = -1;
    for (int64_t i = 0; i < n_rows; i++) {
      if (n_picks == 0 || apart[owner[i]] < twice * nearest[i]) {
        double d = compare(profiles + i * n_places, pick, n_places, norm);
        if (d < nearest[i]) {
          nearest[i] = d;
          owner[i] = n_picks;
        }
      }
      if (nearest[i] > radius) {
        radius = nearest[i];
        furthest = i;
      }
    }
    n_picks++;
  }
  *cover_radius = radius;
  free(nearest);
  free(owner);
  free(apart);
  return n_picks;
}
