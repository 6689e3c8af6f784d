/* Runs the kernels on arrays from files and writes what they give, so that another processor's results can be compared byte for byte.

   driver FOLDER: each array is a file of its bytes, NAME.in or NAME.out. Whole numbers that a kernel takes are in `sizes.in`, in the order
   of `enum` below. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"

int build_graph(const int64_t *, const int64_t *, const int64_t *, int32_t, const spell *, int64_t, const spell *, int64_t, int32_t, graph *);
int sweep_times(int64_t, const int32_t *, const int32_t *, const double *, int32_t, int32_t, const int32_t *, double *);
int sum_neighbours(const int64_t *, const int32_t *, const double *, const int32_t *, int32_t, int32_t, int32_t, int64_t, double *);
int32_t pick_maxmin(const int64_t *, const int32_t *, const double *, int32_t, int32_t, const int32_t *, const double *, const uint8_t *, int32_t,
                    int32_t *, double *, int32_t *, double *);
int bracket(double *, int64_t, int32_t, const double *, double *);
int32_t pick_profiles(const double *, int64_t, int32_t, int32_t, int32_t, int64_t *, double *, double *);
int settle_tracks(int32_t, int64_t, const int32_t *, const int32_t *, const int32_t *, const double *, const double *, const double *, double,
                  double, double, int32_t, int32_t, double *);

enum { ENCOUNTERS, SPELLS, STANDS, NEIGHBOURS, POINTS, N_SIZES };

static const char *folder;

static FILE *open_file(const char *name, const char *end, const char *mode) {
  char path[4096];
  if (snprintf(path, sizeof path, "%s/%s.%s", folder, name, end) >= (int)sizeof path) exit(2);
  FILE *file = fopen(path, mode);
  if (!file) exit(2);
  return file;
}

static void *read_array(const char *name, size_t size, size_t n) {
  FILE *file = open_file(name, "in", "rb");
  void *array = calloc(n + 1, size);
  if (!array || fread(array, size, n, file) != n) exit(2);
  fclose(file);
  return array;
}

static void write_array(const char *name, const void *array, size_t size, size_t n) {
  FILE *file = open_file(name, "out", "wb");
  if (fwrite(array, size, n, file) != n || fclose(file)) exit(2);
}

static void *make_room(size_t size, size_t n) {
  void *array = calloc(n + 1, size);
  if (!array) exit(2);
  return array;
}

static void check(int outcome) {
  if (outcome < 0) exit(3);
}

int main(int argc, char **argv) {
  if (argc != 2) return 2;
  folder = argv[1];
  int64_t *sizes = read_array("sizes", sizeof *sizes, N_SIZES);
  size_t n = (size_t)sizes[ENCOUNTERS], n_points = (size_t)sizes[POINTS];
  graph g = {.vertex_of = make_room(4, n),      .first_encounter = make_room(4, n), .multiplicity = make_room(4, n),
             .is_landmark = make_room(1, n),    .component = make_room(4, n),       .link_from = make_room(4, 2 * n),
             .link_to = make_room(4, 2 * n),    .link_time = make_room(8, 2 * n),   .row_start = make_room(8, n + 1),
             .neighbour = make_room(4, 4 * n),  .time = make_room(8, 4 * n),        .link_before = make_room(4, 2 * n)};
  check(build_graph(read_array("centres", 8, n), read_array("id1", 8, n), read_array("id2", 8, n), (int32_t)n,
                    read_array("still", sizeof(spell), (size_t)sizes[SPELLS]), sizes[SPELLS],
                    read_array("commanded", sizeof(spell), (size_t)sizes[STANDS]), sizes[STANDS], 1, &g));
  size_t v = (size_t)g.n_vertices, n_links = (size_t)g.n_links, n_edges = (size_t)g.n_edges;
  write_array("first_encounter", g.first_encounter, 4, v);
  write_array("multiplicity", g.multiplicity, 4, v);
  write_array("is_landmark", g.is_landmark, 1, v);
  write_array("component", g.component, 4, v);
  write_array("links.sources", g.link_from, 4, n_links);
  write_array("links.targets", g.link_to, 4, n_links);
  write_array("links.times", g.link_time, 8, n_links);
  write_array("links.before", g.link_before, 4, n_links);
  write_array("rows.starts", g.row_start, 8, v + 1);
  write_array("rows.neighbours", g.neighbour, 4, n_edges);
  write_array("rows.times", g.time, 8, n_edges);

  double *start = make_room(8, 2 * v), *pull = make_room(8, v), *xy = make_room(8, 2 * v);
  for (size_t i = 0; i < v; i++) {
    start[2 * i] = (double)(i % 61) * 1000;
    start[2 * i + 1] = (double)(i % 53) * 1000;
    pull[i] = g.is_landmark[i] ? 10 : 0.5;
  }
  check(settle_tracks(g.n_vertices, g.n_links, g.link_from, g.link_to, g.link_before, g.link_time, pull, start, 100, 0.25, 0.125, 3, 20, xy));
  write_array("settled", xy, 8, 2 * v);

  int32_t *places = make_room(4, v), n_hubs = 0;
  for (int32_t i = 0; i < g.n_vertices; i++)
    if (g.is_landmark[i]) places[n_hubs++] = i;
  size_t n_places = (size_t)n_hubs;
  double *times = make_room(8, v * (n_places + 3)); /* rows are padded to the next multiple of four while they are computed */
  check(sweep_times(g.n_links, g.link_from, g.link_to, g.link_time, g.n_vertices, n_hubs, places, times));
  write_array("sweep", times, 8, v * n_places);

  double *sums = make_room(8, v);
  check(sum_neighbours(g.row_start, g.neighbour, g.time, g.multiplicity, g.n_vertices, 0, g.n_vertices, sizes[NEIGHBOURS], sums));
  write_array("sums", sums, 8, v);

  uint8_t *everyone = make_room(1, v);
  memset(everyone, 1, v);
  int32_t *picks = make_room(4, n_points);
  double *distances = make_room(8, n_points * n_points), radius = 0;
  int32_t is_complete = 0;
  int32_t m = pick_maxmin(g.row_start, g.neighbour, g.time, g.n_vertices, n_hubs, places, times, everyone, (int32_t)n_points, picks, distances,
                          &is_complete, &radius);
  check(m);
  check(is_complete - 1);
  write_array("picks", picks, 4, (size_t)m);
  write_array("distances", distances, 8, n_points * n_points);
  write_array("radius", &radius, 8, 1);

  double *between = make_room(8, n_places * n_places), *doubt = make_room(8, v);
  for (size_t i = 0; i < n_places; i++) memcpy(between + i * n_places, times + (size_t)places[i] * n_places, n_places * sizeof *between);
  check(bracket(times, g.n_vertices, n_hubs, between, doubt));
  write_array("middle", times, 8, v * n_places);
  write_array("doubt", doubt, 8, v);

  static const char *const norms[2][3] = {{"max.chosen", "max.distances", "max.radius"}, {"rms.chosen", "rms.distances", "rms.radius"}};
  for (int32_t norm = 0; norm < 2; norm++) {
    int64_t *chosen = make_room(8, n_points);
    memset(distances, 0, n_points * n_points * sizeof *distances);
    m = pick_profiles(times, g.n_vertices, n_hubs, norm, (int32_t)n_points, chosen, distances, &radius);
    check(m);
    write_array(norms[norm][0], chosen, 8, (size_t)m);
    write_array(norms[norm][1], distances, 8, n_points * n_points);
    write_array(norms[norm][2], &radius, 8, 1);
  }
  return 0;
}
