/* Rows of a CSV file of encounters to whole nanoseconds and ids. Only what is plain is read here; the rest is for a reader with words. */
#include "kernels.h"

#include <string.h>

#define OUT_OF_THE_ORDINARY (-2)

enum { T_START, T_END, ID1, ID2, N_COLUMNS };

/* So many digits fit 64 bits; and of so many a decimal number times 10^9 is exact in the 28 digits that Python's decimals have, since the
   nine it gets more are zeros. */
enum { KEPT_DIGITS = 19, MOST_DIGITS = 28 };

#define NS_PER_S 1000000000ULL
#define EARLIEST_S 300000000ULL
#define LATEST_S 4000000000ULL

typedef struct {
  const char *begin;
  const char *end;
} field;

/* The first digits of a number, leading zeros not counted, how many it has in all, and whether any that is not kept is not 0. */
typedef struct {
  uint64_t number;
  int n_digits;
  int has_more;
} digits;

static const uint64_t TEN_TO[KEPT_DIGITS + 1] = {
  1ULL, 10ULL, 100ULL, 1000ULL, 10000ULL, 100000ULL, 1000000ULL, 10000000ULL, 100000000ULL, 1000000000ULL, 10000000000ULL, 100000000000ULL,
  1000000000000ULL, 10000000000000ULL, 100000000000000ULL, 1000000000000000ULL, 10000000000000000ULL, 100000000000000000ULL,
  1000000000000000000ULL, 10000000000000000000ULL};

static int is_blank(char c) { return c == ' ' || c == '\t'; }

static int is_digit(char c) { return c >= '0' && c <= '9'; }

/* Append digits; 0 where they become too many. */
static int read_digits(const char **at, const char *end, digits *read) {
  const char *p = *at;
  digits d = *read;
  for (; p < end && is_digit(*p); p++) {
    d.n_digits += d.number != 0 || *p != '0';
    if (d.n_digits > MOST_DIGITS) return 0;
    if (d.n_digits <= KEPT_DIGITS) d.number = 10 * d.number + (uint64_t)(*p - '0');
    else d.has_more |= *p != '0';
  }
  *at = p;
  *read = d;
  return 1;
}

/* The exponent of a decimal number, or nothing; 0 where it is no exponent or of more than three digits. */
static int read_exponent(const char **at, const char *end, int64_t *exponent) {
  const char *p = *at;
  if (p == end) return 1;
  if (*p != 'e' && *p != 'E') return 0;
  p++;
  int is_negative = p < end && *p == '-';
  p += p < end && (*p == '-' || *p == '+');
  if (p == end || end - p > 3) return 0;
  int64_t value = 0;
  for (; p < end && is_digit(*p); p++) value = 10 * value + (*p - '0');
  *at = p;
  *exponent = is_negative ? -value : value;
  return 1;
}

/* Whole nanoseconds of decimal seconds, half to even; 0 for all that is not plainly within the limits. */
static int read_time(field text, int64_t *ns) {
  const char *p = text.begin, *end = text.end;
  int is_negative = p < end && *p == '-';
  p += p < end && (*p == '-' || *p == '+');
  digits read = {0};
  const char *whole = p;
  if (!read_digits(&p, end, &read)) return 0;
  int64_t n_written = p - whole, exponent = 0, n_decimals = 0;
  if (p < end && *p == '.') {
    const char *decimals = ++p;
    if (!read_digits(&p, end, &read)) return 0;
    n_decimals = p - decimals;
  }
  if (n_written + n_decimals == 0 || !read_exponent(&p, end, &exponent) || p != end) return 0;

  uint64_t number = read.number, limit = (is_negative ? EARLIEST_S : LATEST_S) * NS_PER_S, size = 0;
  int64_t power = exponent - n_decimals + 9; /* the time is number * 10^power [ns], and the digits not kept */
  if (read.n_digits > KEPT_DIGITS) power += read.n_digits - KEPT_DIGITS;
  if (power >= 0) {
    if (read.has_more || (number && (power > KEPT_DIGITS || number > limit / TEN_TO[power]))) return 0;
    if (number) size = number * TEN_TO[power];
  } else if (-power <= KEPT_DIGITS) {
    uint64_t unit = TEN_TO[-power], rest = number % unit;
    size = number / unit;
    if (size > limit || (size == limit && (rest || read.has_more))) return 0;
    size += rest > unit - rest || (rest == unit - rest && (read.has_more || size % 2));
  } /* else it is less than a tenth of a nanosecond */
  *ns = is_negative ? -(int64_t)size : (int64_t)size;
  return 1;
}

static int read_id(field text, int64_t *id) {
  const char *p = text.begin;
  digits read = {0};
  if (p == text.end || !read_digits(&p, text.end, &read) || p != text.end) return 0;
  if (read.n_digits > KEPT_DIGITS || read.number > INT64_MAX) return 0;
  if (text.end - text.begin > 40) return 0; /* leading zeros; a limit of the other reader */
  *id = (int64_t)read.number;
  return 1;
}

/* Find where the field at p ends, and what is in it: quotes off; NULL where quotes are not closed, or closed before the end. */
static const char *find_field(const char *p, const char *end, field *inside) {
  if (p < end && *p == '"') {
    inside->begin = ++p;
    do {
      p = memchr(p, '"', (size_t)(end - p));
      if (!p) return NULL;
      inside->end = p++;
    } while (p < end && *p == '"' && ++p);
    return p == end || *p == ',' || *p == '\n' || *p == '\r' ? p : NULL;
  }
  inside->begin = p;
  while (p < end && *p != ',' && *p != '\n' && *p != '\r') p++;
  inside->end = p;
  return p;
}

static field strip(field text) {
  while (text.begin < text.end && is_blank(*text.begin)) text.begin++;
  while (text.begin < text.end && is_blank(text.end[-1])) text.end--;
  return text;
}

/* Fields of one row that are at the places wanted; n_fields counts all. Returns where the next row begins, or NULL. */
static const char *split_row(const char *p, const char *end, const int64_t *place, int64_t longest, field *wanted, int64_t *n_fields) {
  field inside;
  for (*n_fields = 0;; p++) {
    p = find_field(p, end, &inside);
    if (!p || inside.end - inside.begin > longest) return NULL;
    for (int column = 0; column < N_COLUMNS; column++)
      if (place[column] == *n_fields) wanted[column] = strip(inside);
    ++*n_fields;
    if (p == end) return p;
    if (*p == '\n') return p + 1;
    if (*p == '\r') return p + 1 < end && p[1] == '\n' ? p + 2 : NULL;
  }
}

/* Read n_bytes of rows into columns of `room` rows. place[c] is the field of column c, counted from 0; a field of more than `longest` bytes is
   out of the ordinary, and so is a row of more than n_columns fields, and whatever is not a good row or a blank line. Returns how many rows there are, or a negative number. */
KERNEL int64_t read_rows(const char *text, int64_t n_bytes, const int64_t *place, int64_t n_columns, int64_t longest, int64_t room,
                         int64_t *t_start_ns, int64_t *t_end_ns, int64_t *id1, int64_t *id2) {
  const char *p = text, *end = text + n_bytes;
  int64_t row = 0, n_needed = 0, n_fields;
  for (int column = 0; column < N_COLUMNS; column++) n_needed = place[column] < n_needed ? n_needed : place[column] + 1;
  while (p < end) {
    field wanted[N_COLUMNS] = {{NULL, NULL}};
    const char *begin = p;
    p = split_row(p, end, place, longest, wanted, &n_fields);
    if (!p) return OUT_OF_THE_ORDINARY;
    if (n_fields == 1) {
      while (begin < p && (is_blank(*begin) || *begin == '\r' || *begin == '\n')) begin++;
      if (begin == p) continue;
    }
    if (n_fields < n_needed || n_fields > n_columns || row == room) return OUT_OF_THE_ORDINARY;
    if (!read_time(wanted[T_START], &t_start_ns[row]) || !read_time(wanted[T_END], &t_end_ns[row]) || !read_id(wanted[ID1], &id1[row]) ||
        !read_id(wanted[ID2], &id2[row]) || t_end_ns[row] < t_start_ns[row] || id1[row] == id2[row])
      return OUT_OF_THE_ORDINARY;
    row++;
  }
  return row;
}

/* Rows that a text can have at most: its line ends, and one more. */
KERNEL int64_t count_lines(const char *text, int64_t n_bytes) {
  int64_t n = 1;
  for (int64_t i = 0; i < n_bytes; i++) n += text[i] == '\n';
  return n;
}
