/* A binary heap of vertices, the nearest first, that grows as it must. */
#ifndef BIOBOT_QUEUE_H
#define BIOBOT_QUEUE_H

#include <stdint.h>
#include <stdlib.h>

#include "kernels.h"

typedef struct {
  double at;
  int32_t vertex;
} entry;

typedef struct {
  entry *heap;
  int64_t n, capacity;
} queue;

static inline int queue_push(queue *q, double at, int32_t vertex) {
  if (q->n == q->capacity) {
    int64_t capacity = q->capacity ? 2 * q->capacity : 1024;
    entry *heap = realloc(q->heap, (size_t)capacity * sizeof *heap);
    if (!heap) return NO_MEMORY;
    q->heap = heap;
    q->capacity = capacity;
  }
  int64_t place = q->n++;
  for (int64_t parent; place > 0 && q->heap[parent = (place - 1) / 2].at > at; place = parent) q->heap[place] = q->heap[parent];
  q->heap[place] = (entry){at, vertex};
  return 0;
}

static inline entry queue_pop(queue *q) {
  entry first = q->heap[0], last = q->heap[--q->n];
  int64_t place = 0;
  for (int64_t child; (child = 2 * place + 1) < q->n; place = child) {
    if (child + 1 < q->n && q->heap[child + 1].at < q->heap[child].at) child++;
    if (last.at <= q->heap[child].at) break;
    q->heap[place] = q->heap[child];
  }
  q->heap[place] = last;
  return first;
}

#endif
