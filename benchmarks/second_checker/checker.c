/* A second checker of certificate files, written from docs/reference/certificate_format.md.
 *
 * cc -std=c11 -O2 -ffp-contract=off -frounding-math -o checker checker.c -lm
 * ./checker FILE       exit status: 0 proved, 1 refused, 2 unreadable, 3 not covered
 *
 * Arithmetic rounds to nearest; every bound is moved outward by one step of the last place after each operation. */
#include <ctype.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PROVED, REFUSED, UNREADABLE, NOT_COVERED };

static void stop(int status, const char *format, ...) {
    static const char *words[] = {"PROVED", "REFUSED", "UNREADABLE", "NOT COVERED"};
    va_list arguments; va_start(arguments, format); printf("%s: ", words[status]); vprintf(format, arguments);
    printf("\n"); va_end(arguments); exit(status);
}

static void bad(int wrong, const char *why) { if (wrong) stop(UNREADABLE, "%s", why); }
static void no(int wrong, const char *why) { if (wrong) stop(REFUSED, "%s", why); }

/* ---- memory: blocks are freed in the reverse order ---- */

static void **blocks;
static size_t block_count, block_room;
#define MOST_BYTES ((size_t)2 << 30)

static void *room(size_t count, size_t size) {
    no(size && count > MOST_BYTES / size, "this takes more memory than this checker uses");
    if (block_count == block_room) {
        block_room = block_room ? 2 * block_room : 1024; blocks = realloc(blocks, block_room * sizeof *blocks);
        if (!blocks) abort();
    }
    void *block = calloc(count ? count : 1, size ? size : 1); no(!block, "memory is short");
    return blocks[block_count++] = block;
}

static void release(size_t mark) {
    while (block_count > mark) free(blocks[--block_count]);
}

/* A list that grows: its block is not among those that are released. */
typedef struct { void *data; size_t count, room; } List;

static void *more(List *list, size_t size) {
    if (list->count == list->room) {
        list->room = list->room ? 2 * list->room : 64;
        no(list->room > MOST_BYTES / size, "this takes more memory than this checker uses");
        list->data = realloc(list->data, list->room * size); no(!list->data, "memory is short");
    }
    void *entry = (char *)list->data + size * list->count++; memset(entry, 0, size); return entry;
}

/* ---- intervals ---- */

typedef struct { double lo, hi; } I;

static inline double up(double x) {
    uint64_t bits;
    if (isnan(x)) return INFINITY;
    if (x == INFINITY) return x;
    if (x == 0) return 4.9406564584124654e-324;
    memcpy(&bits, &x, 8); bits += x > 0 ? 1 : (uint64_t)-1; memcpy(&x, &bits, 8); return x;
}
static inline double dn(double x) { return -up(-x); }
static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }

static const I ZERO = {0, 0}, ONE = {1, 1}, ALL = {-INFINITY, INFINITY};
static inline I point(double x) { return (I){x, x}; }
static inline I around(double r) { return (I){-r, r}; }
static inline int is_zero(I a) { return a.lo == 0 && a.hi == 0; }
static inline double mag(I a) { return most(fabs(a.lo), fabs(a.hi)); }
static inline I neg(I a) { return (I){-a.hi, -a.lo}; }
static inline I hull(I a, I b) { return (I){least(a.lo, b.lo), most(a.hi, b.hi)}; }
static inline I meet(I a, I b) { return (I){most(a.lo, b.lo), least(a.hi, b.hi)}; }

/* Whether a + b is the number s itself: the error of a sum is a double (Knuth). */
static inline int exact_sum(double a, double b, double s) {
    double part = s - a; return (a - (s - part)) + (b - part) == 0;
}
static inline I add(I a, I b) {
    if (is_zero(a)) return b;
    if (is_zero(b)) return a;
    double low = a.lo + b.lo, high = a.hi + b.hi;
    return (I){exact_sum(a.lo, b.lo, low) ? low : dn(low), exact_sum(a.hi, b.hi, high) ? high : up(high)};
}
static inline I sub(I a, I b) { return add(a, neg(b)); }
static inline double times(double a, double b) { return a == 0 || b == 0 ? 0 : a * b; }

static inline I mul(I a, I b) {
    if (is_zero(a) || is_zero(b)) return ZERO;
    if (a.lo == 1 && a.hi == 1) return b;
    if (b.lo == 1 && b.hi == 1) return a;
    if (a.lo > 0 && b.lo > 0) return (I){dn(a.lo * b.lo), up(a.hi * b.hi)};
    double p = times(a.lo, b.lo), q = times(a.lo, b.hi), r = times(a.hi, b.lo), s = times(a.hi, b.hi);
    return (I){dn(least(least(p, q), least(r, s))), up(most(most(p, q), most(r, s)))};
}

static int undefined; /* set where an operation has no value on a part of its argument */

static I inverse(I a) {
    if (a.lo <= 0 && a.hi >= 0) { undefined = 1; return ALL; }
    return (I){dn(1 / a.hi), up(1 / a.lo)};
}
static I divide(I a, I b) {
    if (b.lo <= 0 && b.hi >= 0) { undefined = 1; return ALL; }
    if (is_zero(a)) return a;
    if (a.lo > 0 && b.lo > 0 && isfinite(a.hi)) return (I){dn(a.lo / b.hi), up(a.hi / b.lo)};
    double p = a.lo / b.lo, q = a.lo / b.hi, r = a.hi / b.lo, s = a.hi / b.hi;
    if (isnan(p) || isnan(q) || isnan(r) || isnan(s)) return ALL;
    return (I){dn(least(least(p, q), least(r, s))), up(most(most(p, q), most(r, s)))};
}
static I square(I a) {
    I m = {a.lo <= 0 && a.hi >= 0 ? 0 : least(fabs(a.lo), fabs(a.hi)), mag(a)};
    return (I){m.lo > 0 ? most(0, dn(m.lo * m.lo)) : 0, m.hi > 0 ? up(m.hi * m.hi) : 0};
}
static I root(I a) {
    if (a.lo < 0) undefined = 1;
    if (a.hi < 0) return ALL;
    return (I){a.lo > 0 ? most(0, dn(sqrt(a.lo))) : 0, a.hi > 0 ? up(sqrt(a.hi)) : 0};
}
static I whole_power(I a, int n) { /* n >= 0 */
    if (n == 0) return ONE;
    if (n == 1) return a;
    if (n % 2 == 0) return square(whole_power(a, n / 2));
    if (a.lo < 0 && a.hi > 0) {
        I low = whole_power(point(a.lo), n), high = whole_power(point(a.hi), n); return (I){low.lo, high.hi};
    }
    return mul(whole_power(a, n - 1), a);
}

/* ---- elementary functions: series with remainders, in interval arithmetic; libm gives first guesses alone ---- */

/* ln 2 = LN_A + LN_B, pi / 2 = PI_A + PI_B + PI_C; the first parts have 32 and 30 bits, whole multiples are exact */
static const double LN_A = 0x1.62e42fee00000p-1, PI_A = 0x1.921fb54000000p+0, PI_B = 0x1.10b4610000000p-30;
static const I LN_B = {0x1.a39ef35793c76p-33, 0x1.a39ef35793c77p-33};
static const I PI_C = {0x1.a62633145c06ep-58, 0x1.a62633145c06fp-58};
static I PI_HALF, ROOT_TWO_PI;

/* sum of x^k / k! over k < 14, |x| <= .35, and a remainder below 2 |x|^14 / 14! */
static I exp_series(I x) {
    I sum = ONE;
    for (int k = 13; k >= 1; k--) sum = add(ONE, divide(mul(x, sum), point(k)));
    return add(sum, around(1e-17)); /* 2 * .35^14 / 14! < 9.6e-18 */
}
static I exp_at(double x) {
    if (x == -INFINITY) return ZERO;
    if (!(x < 709)) return (I){1e307, INFINITY};
    if (x < -745) return (I){0, 4.9406564584124654e-324};
    double k = nearbyint(x / 0.6931471805599453); I r = sub(sub(point(x), point(k * LN_A)), mul(point(k), LN_B));
    I value = exp_series(r);
    int half = (int)k / 2, rest = (int)k - half; /* two steps, so that neither factor is below the normal numbers */
    I first = {value.lo * ldexp(1, half), value.hi * ldexp(1, half)};
    return (I){most(0, dn(first.lo * ldexp(1, rest))), up(first.hi * ldexp(1, rest))};
}
static I exponential(I a) { return (I){exp_at(a.lo).lo, exp_at(a.hi).hi}; }

static I log_at(double x) { /* x > 0 */
    if (x == INFINITY) return (I){709, INFINITY};
    double y = log(x);
    if (!(fabs(y) < 700)) return (I){-INFINITY, x < 1 ? -699 : INFINITY};
    I z = sub(divide(point(x), exp_at(y)), ONE); /* log(1 + z) lies between z / (1 + z) and z */
    if (!(z.lo > -0.5)) return ALL;
    return add(point(y), hull(divide(z, add(ONE, z)), z));
}
static I logarithm(I a) {
    if (a.lo <= 0) undefined = 1;
    if (a.hi <= 0) return ALL;
    return (I){a.lo > 0 ? log_at(a.lo).lo : -INFINITY, log_at(a.hi).hi};
}

/* sine and cosine of |r| <= 1, with the first term that is left out as the remainder (alternating, falling) */
static void sine_series(I r, I *sine, I *cosine) {
    I q = neg(square(r)), s = ONE, c = ONE;
    for (int k = 10; k >= 1; k--) {
        s = add(ONE, divide(mul(q, s), point(2.0 * k * (2 * k + 1))));
        c = add(ONE, divide(mul(q, c), point(2.0 * k * (2 * k - 1))));
    }
    *sine = mul(r, add(s, around(1e-20)));
    *cosine = add(c, around(1e-20)); /* 1 / 22! < 1e-21 */
}
static void sine_at(double x, I *sine, I *cosine) {
    if (!(fabs(x) <= 1e6)) {
        *sine = *cosine = around(1);
        return;
    }
    double k = nearbyint(x / 1.5707963267948966);
    I r = sub(sub(sub(point(x), point(k * PI_A)), point(k * PI_B)), mul(point(k), PI_C)), s, c;
    sine_series(r, &s, &c); int quarter = (int)(((long)k % 4 + 4) % 4);
    *sine = quarter == 0 ? s : quarter == 1 ? c : quarter == 2 ? neg(s) : neg(c);
    *cosine = quarter == 0 ? c : quarter == 1 ? neg(s) : quarter == 2 ? neg(c) : s;
    *sine = meet(*sine, around(1));
    *cosine = meet(*cosine, around(1));
}
/* whole numbers n that may have (n + shift) pi / 2 in the interval, from first to last; 0 if there are too many */
static int quarters(I a, double shift, long *first, long *last) {
    if (!(mag(a) <= 1e6)) return 0;
    I q = sub(divide(a, PI_HALF), point(shift));
    *first = (long)ceil(q.lo);
    *last = (long)floor(q.hi);
    return 1;
}
static I cosine_of(I a) {
    long first, last;
    if (!quarters(a, 0, &first, &last) || last - first >= 8) return around(1);
    I s, low, high; sine_at(a.lo, &s, &low); sine_at(a.hi, &s, &high); I value = hull(low, high);
    for (long n = first; n <= last; n++) if (n % 2 == 0) value = hull(value, point(n % 4 == 0 ? 1 : -1));
    return value;
}
static I sine_of(I a) {
    long first, last;
    if (!quarters(a, 0, &first, &last) || last - first >= 8) return around(1);
    I c, low, high; sine_at(a.lo, &low, &c); sine_at(a.hi, &high, &c); I value = hull(low, high);
    for (long n = first; n <= last; n++) if (n % 2 != 0) value = hull(value, point(((n % 4) + 4) % 4 == 1 ? 1 : -1));
    return value;
}
static I tangent_of(I a) {
    long first, last, n, pole = 0;
    if (!quarters(a, 0, &first, &last) || last - first >= 8) pole = 1;
    else
        for (n = first; n <= last; n++) pole |= n % 2 != 0;
    if (pole) { undefined = 1; return ALL; }
    I s, c; sine_at(a.lo, &s, &c); double low = divide(s, c).lo; sine_at(a.hi, &s, &c);
    return (I){low, divide(s, c).hi};
}
static I arctangent_at(double x) {
    I bound = around(PI_HALF.hi), s, c;
    if (!isfinite(x)) return x > 0 ? (I){1.5, PI_HALF.hi} : (I){-PI_HALF.hi, -1.5};
    if (x == 0) return ZERO;
    double y = atan(x);
    if (!(fabs(y) < 1.5707963)) return x > 0 ? (I){1.570796, PI_HALF.hi} : (I){-PI_HALF.hi, -1.570796};
    sine_at(y, &s, &c); /* atan x - y = atan((x - tan y) / (1 + x tan y)), between 0 and that quotient */
    if (!(c.lo > 0)) return bound;
    I t = divide(s, c), below = add(ONE, mul(point(x), t));
    if (!(below.lo > 0)) return bound;
    I small = divide(sub(point(x), t), below); return meet(bound, add(point(y), hull(ZERO, small)));
}
static I arctangent(I a) { return (I){arctangent_at(a.lo).lo, arctangent_at(a.hi).hi}; }

static I tanh_at(double x) {
    I e = exp_at(-2 * fabs(x)), value = divide(sub(ONE, e), add(ONE, e));
    value = meet(value, (I){0, least(1, fabs(x))}); return x < 0 ? neg(value) : value;
}
static I hyperbolic(I a) { return (I){tanh_at(a.lo).lo, tanh_at(a.hi).hi}; }

static I absolute(I a) {
    if (a.lo >= 0) return a;
    if (a.hi <= 0) return neg(a);
    return (I){0, mag(a)};
}

/* The upper tail of the standard normal law at one number. */
static I tail_at(double z) {
    if (z < 0) { I t = tail_at(-z); return (I){dn(1 - t.hi), up(1 - t.lo)}; }
    if (z > 37.5) return (I){0, tail_at(37.5).hi};
    I x = point(z), density = divide(exponential(mul(point(-0.5), square(x))), ROOT_TWO_PI);
    /* 1/2 - density * sum of z^(2k+1) / (1 3 5 ... (2k+1)), until ratios are below 1/2 and terms small */
    if (z < 2.5) {
        I term = x, sum = x, q = square(x);
        for (int k = 1; k < 200; k++) {
            term = divide(mul(term, q), point(2 * k + 1)); sum = add(sum, term);
            if (2 * k + 3 > 2 * q.hi && term.hi <= 1e-18 * sum.hi) break;
        }
        if (term.hi > 0) sum.hi = up(sum.hi + term.hi);
        return sub(point(0.5), mul(density, sum));
    }
    int terms = 8 + (int)(300 / (z * z)); /* any number is right: what is left out is something from z on */
    I tail = add(x, (I){0, up(terms / z)});
    for (int k = terms - 1; k >= 1; k--) tail = add(x, divide(point(k), tail));
    return divide(density, tail);
}

static void set_constants(void) {
    PI_HALF = add(point(PI_A), add(point(PI_B), PI_C)); ROOT_TWO_PI = root(mul(point(4), PI_HALF));
}

/* ---- the archive ---- */

static const unsigned char *raw;
static size_t raw_size;

typedef struct { const char *type; int width,
    dims; long shape[4]; size_t count; const unsigned char *data; int named; } Array;
static Array *arrays;
static int array_count;

static uint32_t crc_of(const unsigned char *data, size_t count) {
    static uint32_t table[256];
    if (!table[1])
        for (uint32_t n = 0; n < 256; n++) {
            uint32_t c = n;
            for (int k = 0; k < 8; k++) c = c & 1 ? 0xEDB88320u ^ (c >> 1) : c >> 1;
            table[n] = c;
        }
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t k = 0; k < count; k++) crc = table[(crc ^ data[k]) & 255] ^ (crc >> 8);
    return crc ^ 0xFFFFFFFFu;
}
static unsigned long number_at(size_t place, int width) {
    unsigned long value = 0; bad(place > raw_size || raw_size - place < (size_t)width, "archive: it ends too early");
    for (int k = width - 1; k >= 0; k--) value = value << 8 | raw[place + (size_t)k];
    return value;
}

static void read_array(const unsigned char *data, size_t size, Array *array) {
    static const struct { const char *name; int width; } types[] = {
        {"<f8", 8}, {"<i8", 8}, {"<i4", 4}, {"|i1", 1}, {"|b1", 1}};
    char text[128]; int used = 0, k, type = -1;
    bad(size < 10 || memcmp(data, "\x93NUMPY\x01\x00", 8), "array: no npy of version 1.0");
    size_t length = data[8] | (size_t)data[9] << 8;
    bad(size - 10 < length || length < 40, "array: its header has another length");
    const char *head = (const char *)data + 10, *place = head, *end = head + length;
    for (k = 0; k < 5; k++) {
        int n = snprintf(text, sizeof text, "{'descr': '%s', 'fortran_order': False, 'shape': (", types[k].name);
        if ((size_t)n < length && !memcmp(head, text, (size_t)n)) type = k, used = n;
    }
    bad(type < 0, "array: its header or its type is another"); place += used; array->count = 1;
    while (place < end && *place != ')') {
        long n = 0; const char *first = place;
        for (; place < end && isdigit((unsigned char)*place); place++) {
            n = 10 * n + (*place - '0'); bad(n > 1L << 40, "array: its shape is too large");
        }
        bad(place == first || (*first == '0' && place - first > 1) || array->dims == 4,
            "array: its shape is not well written");
        array->shape[array->dims++] = n;
        bad(n && array->count > ((size_t)1 << 40) / (size_t)n, "array: its shape is too large");
        array->count *= (size_t)n;
        if (place < end && *place == ',') {
            place++;
            if (array->dims == 1 && place < end && *place == ')') break;
            bad(place >= end || *place++ != ' ', "array: its shape is not well written");
            bad(place < end && *place == ')', "array: its shape is not well written");
        } else if (array->dims == 1 || (place < end && *place != ')'))
            stop(UNREADABLE, "array: its shape is not well written");
    }
    bad(end - place < 5 || memcmp(place, "), }", 4), "array: its header is not well written");
    for (place += 4; place < end - 1; place++) bad(*place != ' ', "array: its header is not well written");
    bad(*place != '\n', "array: its header has no line break"); array->type = types[type].name;
    array->width = types[type].width; array->data = data + 10 + length;
    bad(array->count * (size_t)array->width != size - 10 - length, "array: it has another size");
    if (type == 4)
        for (size_t n = 0; n < array->count; n++) bad(array->data[n] > 1, "array: a truth value is neither 0 nor 1");
}

static void read_archive(const char **header, size_t *header_size) {
    char name[32]; bad(raw_size < 22 || number_at(raw_size - 22, 4) != 0x06054b50, "archive: it has no end");
    size_t last = raw_size - 22, count = number_at(last + 10, 2);
    size_t size = number_at(last + 12, 4), start = number_at(last + 16, 4), place = 0, entry = start;
    bad(number_at(last + 4, 2) || number_at(last + 6, 2) || number_at(last + 8, 2) != count ||
        number_at(last + 20, 2), "archive: it has parts or a comment");
    bad(start > last || start + size != last || !count, "archive: its directory is elsewhere");
    arrays = room(count, sizeof *arrays); array_count = (int)count - 1;
    for (size_t k = 0; k < count; k++) {
        if (k) snprintf(name, sizeof name, "%zu.npy", k - 1);
        else snprintf(name, sizeof name, "header.json");
        size_t letters = strlen(name);
        if (number_at(place, 4) != 0x04034b50 || number_at(entry, 4) != 0x02014b50)
            stop(UNREADABLE, "archive: member %zu is not where it should be", k);
        size_t inside = number_at(place + 22, 4);
        if (number_at(place + 6, 2) || number_at(place + 8, 2) || number_at(place + 18, 4) != inside)
            stop(UNREADABLE, "archive: member %zu is not stored as it is", k);
        if (number_at(place + 26, 2) != letters || number_at(place + 28, 2) || number_at(entry + 28, 2) != letters ||
            number_at(entry + 30, 2) || number_at(entry + 32, 2) || number_at(entry + 34, 2))
            stop(UNREADABLE, "archive: member %zu has another name or more fields", k);
        for (size_t j = 0; j < 20; j++) /* flags, method, time, check sum, sizes */
            if (number_at(place + 6 + j, 1) != number_at(entry + 8 + j, 1))
                stop(UNREADABLE, "archive: the directory says something else of member %zu", k);
        size_t data = place + 30 + letters;
        if (number_at(entry + 42, 4) != place || entry + 46 + letters > last || data > start || start - data < inside)
            stop(UNREADABLE, "archive: member %zu is not where it should be", k);
        if (memcmp(raw + place + 30, name, letters) || memcmp(raw + entry + 46, name, letters))
            stop(UNREADABLE, "archive: member %zu should be %s", k, name);
        if (crc_of(raw + data, inside) != number_at(place + 14, 4)) stop(UNREADABLE, "archive: %s was damaged", name);
        if (k) read_array(raw + data, inside, &arrays[k - 1]);
        else *header = (const char *)raw + data, *header_size = inside;
        place = data + inside; entry += 46 + letters;
    }
    bad(place != start || entry != last, "archive: something is between its members");
}

static double real_at(const Array *a, size_t k) { double x; memcpy(&x, a->data + 8 * k, 8); return x; }
static long whole_at(const Array *a, size_t k) {
    int64_t x; int32_t y;
    if (a->width == 8) return memcpy(&x, a->data + 8 * k, 8), (long)x;
    if (a->width == 4) return memcpy(&y, a->data + 4 * k, 4), y;
    return (signed char)a->data[k];
}

/* ---- the header ---- */

typedef struct Json {
    enum { NOTHING, TRUTH, NUMBER, TEXT, LIST, TABLE } kind;
    int truth, whole, count; double number; char *text, *key;
    struct Json *first, *last, *next;
} Json;

static const char *json_place, *json_end;

static void json_blanks(void) {
    while (json_place < json_end && *json_place && strchr(" \t\r\n", *json_place)) json_place++;
}
static void json_wants(const char *word) {
    size_t n = strlen(word);
    if ((size_t)(json_end - json_place) < n || memcmp(json_place, word, n))
        stop(UNREADABLE, "header: `%s` is missing in the JSON", word);
    json_place += n;
}
static unsigned json_hex(void) {
    unsigned code = 0;
    for (int k = 0; k < 4; k++) {
        bad(json_place >= json_end || !isxdigit((unsigned char)*json_place), "header: a wrong \\u");
        int c = tolower((unsigned char)*json_place++);
        code = code * 16 + (unsigned)(isdigit(c) ? c - '0' : c - 'a' + 10);
    }
    return code;
}
static char *json_text(void) {
    json_wants("\""); char *text, *out; const char *scan = json_place;
    while (scan < json_end && *scan != '"') scan += *scan == '\\' ? 2 : 1;
    bad(scan >= json_end, "header: a text has no end"); out = text = room((size_t)(scan - json_place) + 1, 1);
    while (*json_place != '"') {
        unsigned char c = (unsigned char)*json_place++; bad(c < 32, "header: a control character in a text");
        if (c != '\\') {
            *out++ = (char)c;
            continue;
        }
        c = (unsigned char)*json_place++;
        const char *from = "\"\\/bfnrt", *to = "\"\\/\b\f\n\r\t", *found = c ? strchr(from, c) : NULL;
        if (found) *out++ = to[found - from];
        else if (c == 'u') {
            unsigned code = json_hex();
            if (code >= 0xD800 && code < 0xDC00) {
                json_wants("\\u"); unsigned low = json_hex();
                bad(low < 0xDC00 || low > 0xDFFF, "header: half a character");
                code = 0x10000 + ((code - 0xD800) << 10) + (low - 0xDC00);
            } else if (code >= 0xDC00 && code <= 0xDFFF) stop(UNREADABLE, "header: half a character");
            bad(!code, "header: a text with the character 0");
            if (code < 0x80) *out++ = (char)code;
            else if (code < 0x800) *out++ = (char)(0xC0 | code >> 6), *out++ = (char)(0x80 | (code & 63));
            else if (code < 0x10000) {
                *out++ = (char)(0xE0 | code >> 12), *out++ = (char)(0x80 | (code >> 6 & 63));
                *out++ = (char)(0x80 | (code & 63));
            } else {
                *out++ = (char)(0xF0 | code >> 18), *out++ = (char)(0x80 | (code >> 12 & 63));
                *out++ = (char)(0x80 | (code >> 6 & 63)), *out++ = (char)(0x80 | (code & 63));
            }
        } else stop(UNREADABLE, "header: a wrong escape in a text");
    }
    json_place++; return text;
}
static int same_key(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static Json *json_value(int depth) {
    Json *value = room(1, sizeof *value); bad(depth > 100, "header: it is too deep"); json_blanks();
    char c = json_place < json_end ? *json_place : 0;
    if (c == '{' || c == '[') {
        char close = c == '{' ? '}' : ']'; value->kind = c == '{' ? TABLE : LIST; json_place++; json_blanks();
        if (json_place < json_end && *json_place == close) return json_place++, value;
        for (;;) {
            char *key = NULL; json_blanks();
            if (c == '{') { key = json_text(); json_blanks(); json_wants(":"); }
            Json *entry = json_value(depth + 1); entry->key = key;
            if (value->last) value->last->next = entry;
            else value->first = entry;
            value->last = entry; value->count++; json_blanks();
            if (json_place < json_end && *json_place == ',') json_place++;
            else break;
        }
        json_wants(close == '}' ? "}" : "]");
        if (c == '{') {
            char **keys = room((size_t)value->count, sizeof *keys); int n = 0;
            for (Json *e = value->first; e; e = e->next) keys[n++] = e->key;
            qsort(keys, (size_t)n, sizeof *keys, same_key);
            for (int k = 1; k < n; k++)
                if (!strcmp(keys[k - 1], keys[k])) stop(UNREADABLE, "header: `%s` stands twice", keys[k]);
        }
    } else if (c == '"') {
        value->kind = TEXT; value->text = json_text();
    } else if (c == 't' || c == 'f') {
        value->kind = TRUTH; value->truth = c == 't'; json_wants(c == 't' ? "true" : "false");
    } else if (c == 'n') json_wants("null");
    else {
        const char *first = json_place, *p = json_place, *digits;
        if (p < json_end && *p == '-') p++;
        digits = p;
        while (p < json_end && isdigit((unsigned char)*p)) p++;
        bad(p == digits || (*digits == '0' && p - digits > 1), "header: no JSON value"); value->kind = NUMBER;
        value->whole = 1; long length = p - digits;
        for (int part = 0; part < 2; part++) {
            if (p >= json_end || (part ? *p != 'e' && *p != 'E' : *p != '.')) continue;
            value->whole = 0; p++;
            if (part && p < json_end && (*p == '+' || *p == '-')) p++;
            digits = p;
            while (p < json_end && isdigit((unsigned char)*p)) p++;
            bad(p == digits, "header: a number ends too early");
        }
        bad(value->whole && length > 18, "header: a whole number has more than 18 digits");
        char *copy = room((size_t)(p - first) + 1, 1); memcpy(copy, first, (size_t)(p - first));
        value->number = strtod(copy, NULL); bad(!(fabs(value->number) <= 1e150), "header: a number is above 1e150");
        json_place = p;
    }
    return value;
}

static void check_utf8(const unsigned char *p, size_t n) {
    for (size_t k = 0; k < n;) {
        int extra = p[k] < 0x80 ? 0 : p[k] >= 0xC2 && p[k] < 0xE0 ? 1 : (p[k] & 0xF0) == 0xE0 ? 2 : p[k] >= 0xF0 &&
            p[k] < 0xF5 ? 3 : -1;
        unsigned long code = extra > 0 ? p[k] & (0x3Fu >> extra) : p[k];
        bad(extra < 0 || n - k <= (size_t)extra, "header: it is not UTF-8");
        for (int j = 1; j <= extra; j++) {
            bad((p[k + (size_t)j] & 0xC0) != 0x80, "header: it is not UTF-8");
            code = code << 6 | (p[k + (size_t)j] & 0x3F);
        }
        bad((extra == 2 && (code < 0x800 || (code >= 0xD800 && code < 0xE000))) ||
            (extra == 3 && (code < 0x10000 || code > 0x10FFFF)) || code == 0, "header: it is not UTF-8");
        k += (size_t)extra + 1;
    }
}

/* Entries: `keys` are separated by blanks; one with a question mark may be missing. */
static void has_keys(const Json *table, const char *what, const char *keys) {
    int found = 0;
    if (table->kind != TABLE) stop(UNREADABLE, "header: %s is no table", what);
    for (const char *p = keys; *p;) {
        size_t n = strcspn(p, " "); int optional = p[n - 1] == '?', present = 0;
        for (const Json *e = table->first; e; e = e->next)
            present |= strlen(e->key) == n - (size_t)optional && !strncmp(e->key, p, n - (size_t)optional);
        if (!present && !optional) stop(UNREADABLE, "header: `%.*s` is missing in %s", (int)n, p, what);
        found += present; p += n + (p[n] == ' ');
    }
    if (found != table->count) stop(UNREADABLE, "header: %s has an unknown key", what);
}
static const Json *get(const Json *table, const char *key) {
    for (const Json *e = table->first; e; e = e->next) if (!strcmp(e->key, key)) return e;
    return NULL;
}
static const Json *get_list(const Json *table, const char *key, int count) {
    const Json *list = get(table, key);
    if (list->kind != LIST || (count >= 0 && list->count != count))
        stop(UNREADABLE, "header: `%s` is no list of the right length", key);
    return list;
}
static double number_of(const Json *value, const char *what) {
    if (value->kind != NUMBER) stop(UNREADABLE, "header: `%s` is no number", what);
    return value->number;
}
static long whole_of(const Json *value, const char *what, long low, long high) {
    if (value->kind != NUMBER || !value->whole || value->number < (double)low || value->number > (double)high)
        stop(UNREADABLE, "header: `%s` is no whole number from %ld to %ld", what, low, high);
    return (long)value->number;
}
static char *text_of(const Json *value, const char *what) {
    if (value->kind != TEXT) stop(UNREADABLE, "header: `%s` is no text", what);
    return value->text;
}
static char *name_of(const Json *value, const char *what) {
    char *name = text_of(value, what), *p = name;
    if (isdigit((unsigned char)*p) || !*p) stop(UNREADABLE, "header: `%s` is no name", what);
    for (; *p; p++)
        if ((unsigned char)*p > 127 || (!isalnum((unsigned char)*p) && *p != '_'))
            stop(UNREADABLE, "header: `%s` is no name", what);
    return name;
}
static double *numbers_of(const Json *table, const char *key, int count) {
    const Json *list = get_list(table, key, count);
    double *values = room((size_t)list->count, sizeof *values), *p = values;
    for (const Json *e = list->first; e; e = e->next) *p++ = number_of(e, key);
    return values;
}
static double *matrix_of(const Json *table, const char *key, int rows, int *columns) {
    const Json *list = get_list(table, key, rows);
    if (*columns < 0) *columns = list->first->kind == LIST ? list->first->count : 0;
    double *values = room((size_t)rows * (size_t)*columns, sizeof *values), *p = values;
    for (const Json *row = list->first; row; row = row->next) {
        if (row->kind != LIST || row->count != *columns) stop(UNREADABLE, "header: `%s` has another shape", key);
        for (const Json *e = row->first; e; e = e->next) *p++ = number_of(e, key);
    }
    return values;
}
/* The array that a number names; dims and shape are checked, -1 is any length. Kinds: f, i (whole), b. */
static const Array *array_of(const Json *value, const char *what, char kind, int dims, long a, long b, long c) {
    long shape[3] = {a, b, c}; Array *array = &arrays[whole_of(value, what, 0, array_count - 1L)]; array->named = 1;
    if (array->type[1] != kind || array->dims != dims) stop(UNREADABLE, "array: `%s` has another type or shape", what);
    for (int k = 0; k < dims; k++)
        if (shape[k] >= 0 && array->shape[k] != shape[k]) stop(UNREADABLE, "array: `%s` has another shape", what);
    return array;
}
static double *reals_of(const Array *array, const char *what, int infinite) {
    double *values = room(array->count, sizeof *values);
    for (size_t k = 0; k < array->count; k++) {
        values[k] = real_at(array, k);
        if (!(fabs(values[k]) <= 1e150 || (infinite && values[k] == INFINITY)))
            stop(REFUSED, "`%s` has numbers that are not finite, or above 1e150", what);
    }
    return values;
}
static long *wholes_of(const Array *array, const char *what, long low, long high) {
    long *values = room(array->count, sizeof *values);
    for (size_t k = 0; k < array->count; k++) {
        values[k] = whole_at(array, k);
        if (values[k] < low || values[k] > high) stop(REFUSED, "`%s` has numbers beyond %ld to %ld", what, low, high);
    }
    return values;
}

/* ---- the problem ---- */

enum { NUM, VAR, TIME, ADD, SUB, MUL, DIV, NEG, POW, MIN, MAX, ABS, ATAN, COS, EXP, LOG, SIN, SQRT, TAN, TANH };
typedef struct { int kind, a, b, constant; double number; } Op;
typedef struct { List ops; int bare; } Tape; /* the last operation is the result; bare: the state that it is, or -1 */

typedef struct { int agent, index, is_input; } Other;
typedef struct Agent {
    char *name, **states, **inputs, **disturbances, **parameters; int d, m, p, k, K, nd, np, others, timed;
    double *parameter, *A, *B, *c, *state_low, *state_high, *input_low, *input_high, *start_low, *start_high;
    I *disturbance, *N, *M; Tape *f, *y;
    Other *other; /* states and inputs of others that the dynamics name; variables after d + m + nd */
} Agent;
typedef struct { char *name; int agent, moves_low, moves_high; double *low, *high; } Region;
typedef struct { char *name; int agent[2], n, moves_low, moves_high, *output[2], at; double *low, *high,
    *radius; } Pair;

static Agent *agents;
static Region *regions;
static Pair *pairs;
static int agent_count, region_count, pair_count, P, Q, nodes, initial, cosafe, *accepting, *aroot, *avar, *alow,
    *ahigh;
static long T;
static const char *formula_text;

static double region_low(const Region *r, long t, int k) { return r->low[(r->moves_low ? t * agents[r->agent].p
    : 0) + k]; }
static double region_high(const Region *r, long t, int k) { return r->high[(r->moves_high ? t * agents[r->agent].p
    : 0) + k]; }
static double pair_low(const Pair *r, long t, int k) { return r->low[(r->moves_low ? t * r->n : 0) + k]; }
static double pair_high(const Pair *r, long t, int k) { return r->high[(r->moves_high ? t * r->n : 0) + k]; }
static double pair_radius(const Pair *r, long t) { return r->radius[r->moves_low ? t : 0]; }

static int find_name(char **names, int count, const char *name) {
    for (int k = 0; k < count; k++) if (!strcmp(names[k], name)) return k;
    return -1;
}

static const char *ex; /* where the parser of expressions is */
static Agent *ex_agent;
static Tape *ex_tape;
static int ex_output, ex_depth;

static int ex_sum(void);
static void ex_blanks(void) { while (*ex == ' ') ex++; }
static int ex_op(int kind, int a, int b, double number) {
    /* constant: 1 numbers alone, 2 a parameter. What numbers give is for exponents; values are enclosed step by step,
     * which holds both the real result and the one that is rounded. */
    Op *ops = ex_tape->ops.data, new = {kind, a, b, kind != NUM ? 0 : b == -1 ? 1 : 2, number};
    for (int k = 0; k < (int)ex_tape->ops.count; k++)
        if (ops[k].kind == kind && ops[k].a == a && ops[k].b == b && (ops[k].constant || ops[k].number == number) &&
            (kind != NUM || ops[k].number == number))
            return k;
    if (kind >= ADD && kind <= NEG && ops[a].constant == 1 && (b < 0 || ops[b].constant == 1)) {
        double x = ops[a].number, y = b < 0 ? 0 : ops[b].number;
        new.number = kind == ADD ? x + y : kind == SUB ? x - y : kind == MUL ? x * y : kind == DIV ? x / y : -x;
        bad(!isfinite(new.number), "an expression has a number that is not finite"); new.constant = 1;
    }
    no(ex_tape->ops.count > 20000, "an expression is too long for this checker");
    *(Op *)more(&ex_tape->ops, sizeof(Op)) = new;
    return (int)ex_tape->ops.count - 1;
}
static int ex_name(char *name) {
    int k, n; Agent *a = ex_agent;
    if (*ex == '.') { /* of another agent */
        const char *first = ++ex;
        while (isalnum((unsigned char)*ex) || *ex == '_') ex++;
        char *member = room((size_t)(ex - first) + 1, 1); memcpy(member, first, (size_t)(ex - first));
        for (n = 0; n < agent_count && strcmp(agents[n].name, name); n++) {}
        if (ex_output || n == agent_count || &agents[n] == a) stop(UNREADABLE, "an expression names `%s.%s`, which is unknown", name,
            member);
        Other o = {n, find_name(agents[n].states, agents[n].d, member), 0};
        if (o.index < 0) o.is_input = 1, o.index = find_name(agents[n].inputs, agents[n].m, member);
        if (o.index < 0) stop(UNREADABLE, "an expression names `%s.%s`, which is unknown", name, member);
        for (k = 0; k < a->others; k++)
            if (a->other[k].agent == n && a->other[k].index == o.index && a->other[k].is_input == o.is_input) break;
        if (k == a->others) {
            Other *all = room((size_t)k + 1, sizeof *all);
            if (k) memcpy(all, a->other, (size_t)k * sizeof *all);
            all[k] = o, a->other = all, a->others++;
        }
        return ex_op(VAR, a->d + a->m + a->nd + k, -1, 0);
    }
    if ((k = find_name(a->states, a->d, name)) >= 0) return ex_op(VAR, k, -1, 0);
    if (!ex_output) {
        if ((k = find_name(a->inputs, a->m, name)) >= 0) return ex_op(VAR, a->d + k, -1, 0);
        if ((k = find_name(a->disturbances, a->nd, name)) >= 0) return ex_op(VAR, a->d + a->m + k, -1, 0);
    }
    if ((k = find_name(a->parameters, a->np, name)) >= 0) return ex_op(NUM, -1, -3, a->parameter[k]);
    if (!strcmp(name, "t") && !ex_output) { a->timed = 1; return ex_op(TIME, -1, -1, 0); }
    if (!strcmp(name, "pi")) return ex_op(NUM, -1, -3, 3.141592653589793);
    stop(UNREADABLE, "an expression names `%s`, which is unknown", name); return 0;
}
static int ex_atom(void) {
    ex_blanks();
    if (*ex == '(') {
        ex++; int a = ex_sum(); ex_blanks(); bad(*ex++ != ')', "an expression lacks a bracket"); return a;
    }
    if (isdigit((unsigned char)*ex) || (*ex == '.' && isdigit((unsigned char)ex[1]))) {
        const char *p = ex;
        while (isdigit((unsigned char)*p)) p++;
        if (*p == '.') p++;
        while (isdigit((unsigned char)*p)) p++;
        if (*p == 'e' || *p == 'E') {
            const char *q = p + 1;
            if (*q == '+' || *q == '-') q++;
            bad(!isdigit((unsigned char)*q), "an expression has a number that ends too early");
            while (isdigit((unsigned char)*q)) q++;
            p = q;
        }
        bad(isalpha((unsigned char)*p) || *p == '_' || *p == '.', "an expression has a wrong number");
        char *copy = room((size_t)(p - ex) + 1, 1); memcpy(copy, ex, (size_t)(p - ex));
        double number = strtod(copy, NULL); bad(!(number <= 1e150), "an expression has a number above 1e150"); ex = p;
        return ex_op(NUM, -1, -1, number);
    }
    const char *first = ex;
    while (isalnum((unsigned char)*ex) || *ex == '_') ex++;
    bad(ex == first, "an expression is not well written"); char *name = room((size_t)(ex - first) + 1, 1);
    memcpy(name, first, (size_t)(ex - first)); const char *after = ex; ex_blanks();
    if (*ex != '(') return ex = after, ex_name(name);
    static const char *functions[] = {"min", "max", "abs", "atan", "cos", "exp", "log", "sin", "sqrt", "tan", "tanh",
        "clip"};
    int kind = 0, given[3] = {-1, -1, -1}, count = 0, result = -1;
    while (kind < 12 && strcmp(functions[kind], name)) kind++;
    if (kind == 12) stop(UNREADABLE, "an expression has the unknown function `%s`", name);
    do {
        ex++; int a = ex_sum();
        if (count < 3) given[count] = a;
        result = count && kind < 2 ? ex_op(MIN + kind, result, a, 0) : a; count++; ex_blanks();
    } while (*ex == ',');
    bad(*ex++ != ')', "an expression lacks a bracket");
    if (kind < 2 ? count < 2 : count != (kind == 11 ? 3 : 1)) stop(UNREADABLE, "`%s` has another number of arguments",
        name);
    if (kind < 2) return result;
    if (kind == 11) return ex_op(MIN, ex_op(MAX, given[0], given[1], 0), given[2], 0);
    return ex_op(MIN + kind, given[0], -1, 0);
}
static int ex_unary(void) {
    bad(++ex_depth > 400, "an expression is too deep"); int result; ex_blanks();
    if (*ex == '-' || *ex == '+') {
        int minus = *ex++ == '-'; result = ex_unary();
        if (minus) result = ex_op(NEG, result, -1, 0);
    } else {
        result = ex_atom(); ex_blanks();
        if (*ex == '^' || (*ex == '*' && ex[1] == '*')) {
            ex += *ex == '^' ? 1 : 2; int power = ex_unary(); Op *exponent = (Op *)ex_tape->ops.data + power;
            if (exponent->constant) result = ex_op(POW, result, -1, exponent->number);
            else result = ex_op(EXP, ex_op(MUL, power, ex_op(LOG, result, -1, 0), 0), -1, 0);
        }
    }
    ex_depth--; return result;
}
static int ex_product(void) {
    int a = ex_unary();
    for (;;) {
        ex_blanks();
        if ((*ex != '*' && *ex != '/')) return a;
        int kind = *ex++ == '*' ? MUL : DIV; a = ex_op(kind, a, ex_unary(), 0);
    }
}
static int ex_sum(void) {
    int a = ex_product();
    for (;;) {
        ex_blanks();
        if (*ex != '+' && *ex != '-') return a;
        int kind = *ex++ == '+' ? ADD : SUB; a = ex_op(kind, a, ex_product(), 0);
    }
}
static void parse_expression(const char *text, Agent *agent, Tape *tape, int output) {
    ex = text, ex_agent = agent, ex_tape = tape, ex_output = output, ex_depth = 0; int last = ex_sum();
    if (*ex) stop(UNREADABLE, "the expression `%s` is not well written", text);
    Op *op = (Op *)tape->ops.data + last; tape->bare = op->kind == VAR && op->a < agent->d ? op->a : -1;
    if (last != (int)tape->ops.count - 1) { /* the result goes last: one more step that changes nothing */
        Op copy = {ADD, last, -1, 0, 0};
        *(Op *)more(&tape->ops, sizeof(Op)) = copy;
    }
}

/* Values, gradients and Hessians by n variables: out[0], out[1 .. n], out[1 + n + (i (i + 1) / 2 + j)], j <= i. */
static void chain(I *to, const I *a, int n, int order, I g, I g1, I g2) {
    to[0] = g;
    if (order >= 1)
        for (int i = 1; i <= n; i++) to[i] = mul(g1, a[i]);
    if (order >= 2)
        for (int i = 0, h = 1 + n; i < n; i++)
            for (int j = 0; j <= i; j++, h++)
                to[h] = add(mul(g1, a[h]), mul(g2, i == j ? square(a[1 + i]) : mul(a[1 + i], a[1 + j])));
}
static void evaluate(const Tape *tape, const I *variables, int n, int order, double time, I *out) {
    const Op *ops = tape->ops.data;
    size_t mark = block_count, size = order == 0 ? 1 : order == 1 ? 1 + (size_t)n : 1 + (size_t)(n + n * (n + 1) / 2);
    I *all = room(tape->ops.count * size, sizeof *all), g, g1, g2;
    for (size_t k = 0; k < tape->ops.count; k++) {
        const Op *op = ops + k; I *to = all + k * size;
        const I *a = op->a >= 0 && op->kind >= ADD ? all + (size_t)op->a * size : NULL;
        const I *b = op->b >= 0 && op->kind >= ADD ? all + (size_t)op->b * size : NULL; I x = a ? a[0] : ZERO;
        g1 = g2 = ALL;
        switch (op->kind) {
        case NUM: to[0] = point(op->number); continue;
        case TIME: to[0] = point(time); continue;
        case VAR:
            to[0] = variables[op->a];
            if (order) to[1 + op->a] = ONE;
            continue;
        case ADD: case SUB:
            for (size_t i = 0; i < size; i++) to[i] = !b ? a[i] : op->kind == ADD ? add(a[i], b[i]) : sub(a[i], b[i]);
            continue;
        case NEG:
            for (size_t i = 0; i < size; i++) to[i] = neg(a[i]);
            continue;
        case MUL: case DIV: {
            size_t inner = block_count;
            if (op->kind == DIV) { /* times 1 / b */
                I *c = room(size, sizeof *c), q = inverse(b[0]), q2 = square(q);
                chain(c, b, n, order, q, neg(q2), mul(point(2), mul(q, q2))); b = c;
            }
            to[0] = a == b ? square(x) : op->kind == DIV ? divide(x, all[(size_t)op->b * size]) : mul(x, b[0]);
            if (order >= 1)
                for (int i = 1; i <= n; i++) to[i] = add(mul(x, b[i]), mul(b[0], a[i]));
            if (order >= 2)
                for (int i = 0, h = 1 + n; i < n; i++)
                    for (int j = 0; j <= i; j++, h++)
                        to[h] = add(add(mul(x, b[h]), mul(b[0], a[h])),
                            add(mul(a[1 + i], b[1 + j]), mul(a[1 + j], b[1 + i])));
            release(inner); continue;
        }
        case MIN: case MAX: {
            const I *first = op->kind == MIN ? a : b, *second = op->kind == MIN ? b : a; /* first where it is lower */
            if (first[0].hi < second[0].lo) memcpy(to, a, size * sizeof *to);
            else if (second[0].hi < first[0].lo) memcpy(to, b, size * sizeof *to);
            else {
                to[0] = op->kind == MIN ? (I){least(a[0].lo, b[0].lo), least(a[0].hi, b[0].hi)}
                                        : (I){most(a[0].lo, b[0].lo), most(a[0].hi, b[0].hi)};
                for (size_t i = 1; i < size; i++) to[i] = i <= (size_t)n ? hull(a[i], b[i]) : ALL;
            }
            continue;
        }
        case POW:
            if (op->number == floor(op->number) && fabs(op->number) <= 1000) {
                int e = (int)fabs(op->number), negative = op->number < 0; I base = negative ? inverse(x) : x;
                g = whole_power(base, e);
                if (e == 0) g1 = g2 = ZERO;
                else if (negative) {
                    g1 = mul(point(-e), whole_power(base, e + 1));
                    g2 = mul(point((double)e * (e + 1)), whole_power(base, e + 2));
                } else {
                    g1 = mul(point(e), whole_power(x, e - 1));
                    g2 = e == 1 ? ZERO : mul(point((double)e * (e - 1)), whole_power(x, e - 2));
                }
            } else if (op->number == 0.5 && x.lo >= 0) g = root(x);
            else {
                g = exponential(mul(point(op->number), logarithm(x)));
                if (x.lo > 0) {
                    g1 = mul(point(op->number), divide(g, x)); g2 = mul(sub(point(op->number), ONE), divide(g1, x));
                }
            }
            if (op->number == 0.5 && x.lo > 0) {
                g1 = inverse(mul(point(2), g)); g2 = neg(divide(g1, mul(point(2), x)));
            }
            break;
        case ABS:
            g = absolute(x); g1 = x.lo > 0 ? ONE : x.hi < 0 ? point(-1) : around(1);
            g2 = x.lo > 0 || x.hi < 0 ? ZERO : ALL; break;
        case ATAN:
            g = arctangent(x); g1 = inverse(add(ONE, square(x))); g2 = mul(mul(point(-2), x), square(g1)); break;
        case COS: g = cosine_of(x), g1 = neg(sine_of(x)), g2 = neg(g); break;
        case SIN: g = sine_of(x), g1 = cosine_of(x), g2 = neg(g); break;
        case EXP: g = g1 = g2 = exponential(x); break;
        case LOG:
            g = logarithm(x);
            if (x.lo > 0) g1 = inverse(x), g2 = neg(square(g1));
            break;
        case SQRT:
            g = root(x);
            if (x.lo > 0) g1 = inverse(mul(point(2), g)), g2 = neg(divide(g1, mul(point(2), x)));
            break;
        case TAN:
            g = tangent_of(x); g1 = add(ONE, square(g)); g2 = mul(mul(point(2), g), g1); break;
        default: /* TANH */
            g = hyperbolic(x); g1 = meet(sub(ONE, square(g)), (I){0, 1}); g2 = mul(mul(point(-2), g), g1);
        }
        chain(to, a, n, order, g, g1, g2);
    }
    memcpy(out, all + (tape->ops.count - 1) * size, size * sizeof *out); release(mark);
}

static char **names_of(const Json *list, const char *what) {
    char **names = room((size_t)list->count, sizeof *names); int k = 0;
    for (const Json *e = list->first; e; e = e->next) names[k++] = name_of(e, what);
    return names;
}
/* A corner of a region or pair: one list, or T + 1 of them. */
static double *corner_of(const Json *list, int n, double open, int *moves) {
    bad(list->kind != LIST, "header: `low` or `high` is no list");
    *moves = list->first && list->first->kind == LIST;
    bad(*moves ? list->count != T + 1 : list->count != n, "header: `low` or `high` has another length");
    double *values = room((size_t)list->count * (size_t)(*moves ? n : 1), sizeof *values), *p = values;
    for (const Json *row = list->first; row; row = row->next) {
        bad(*moves && (row->kind != LIST || row->count != n), "header: `low` or `high` has another length");
        for (const Json *e = *moves ? row->first : row; e; e = *moves ? e->next : NULL)
            *p++ = e->kind == NOTHING ? open : number_of(e, "low or high");
    }
    return values;
}
static void box_of(const Json *table, const char *low, const char *high, int n, double **a, double **b, int strict) {
    *a = numbers_of(table, low, n), *b = numbers_of(table, high, n);
    for (int k = 0; k < n; k++)
        if (strict ? !((*a)[k] < (*b)[k]) : !((*a)[k] <= (*b)[k])) stop(UNREADABLE, "header: `%s` is above `%s`", low,
            high);
}
static int not_covered; /* a problem with what this checker does not know: said after the file was read */

static void read_agent(const Json *table, Agent *a) {
    int columns = -1, k = 0;
    has_keys(table, "an agent",
        "name states inputs dynamics? A? B? c? disturbances? parameters? outputs state_low state_high "
             "input_low input_high start_low start_high noise distributions? noise_scale? shared_noise?");
    a->name = name_of(get(table, "name"), "name"); const Json *list = get_list(table, "states", -1), *e;
    a->d = list->count, a->states = names_of(list, "states"); list = get_list(table, "inputs", -1);
    a->m = list->count, a->inputs = names_of(list, "inputs"); bad(!a->d, "header: an agent has no state");
    if ((list = get(table, "disturbances"))) {
        bad(list->kind != TABLE, "header: `disturbances` is no table"); a->nd = list->count;
        a->disturbances = room((size_t)a->nd, sizeof *a->disturbances), a->disturbance = room((size_t)a->nd, sizeof(I));
        for (e = list->first, k = 0; e; e = e->next, k++) {
            Json key = {.kind = TEXT, .text = e->key}; a->disturbances[k] = name_of(&key, "disturbances");
            bad(e->kind != LIST || e->count != 2, "header: a disturbance is no pair of numbers");
            a->disturbance[k] = (I){number_of(e->first, "disturbances"), number_of(e->last, "disturbances")};
            bad(!(a->disturbance[k].lo <= a->disturbance[k].hi), "header: a disturbance is empty");
        }
    }
    if ((list = get(table, "parameters"))) {
        bad(list->kind != TABLE, "header: `parameters` is no table"); a->np = list->count;
        a->parameters = room((size_t)a->np, sizeof *a->parameters), a->parameter = room((size_t)a->np, sizeof(double));
        for (e = list->first, k = 0; e; e = e->next, k++) {
            Json key = {.kind = TEXT, .text = e->key};
            a->parameters[k] = name_of(&key, "parameters"), a->parameter[k] = number_of(e, "parameters");
        }
    }
    char **all = room((size_t)(a->d + a->m + a->nd), sizeof *all);
    for (k = 0; k < a->d + a->m + a->nd; k++) {
        all[k] = k < a->d ? a->states[k] : k < a->d + a->m ? a->inputs[k - a->d] : a->disturbances[k - a->d - a->m];
        if (find_name(all, k, all[k]) >= 0) stop(UNREADABLE, "header: `%s` stands for two things", all[k]);
    }
    box_of(table, "state_low", "state_high", a->d, &a->state_low, &a->state_high, 1);
    box_of(table, "input_low", "input_high", a->m, &a->input_low, &a->input_high, 0);
    box_of(table, "start_low", "start_high", a->d, &a->start_low, &a->start_high, 0);
    for (k = 0; k < a->d; k++)
        if (a->start_low[k] < a->state_low[k] || a->start_high[k] > a->state_high[k])
            stop(REFUSED, "a start of `%s` is outside its workspace", a->name);
    double *noise = matrix_of(table, "noise", a->d, &columns); a->k = columns;
    a->N = room((size_t)(a->d * a->k), sizeof(I));
    for (k = 0; k < a->d * a->k; k++) a->N[k] = point(noise[k]);
    if ((list = get(table, "distributions"))) {
        bad(list->kind != LIST || list->count != a->k, "header: `distributions` is no list of the right length");
        for (e = list->first, k = 0; e; e = e->next, k++) {
            const Json *law = e->kind == TABLE ? get(e, "law") : NULL;
            bad(!law || law->kind != TEXT, "header: a distribution has no law");
            if (strcmp(law->text, "gaussian")) { not_covered = 1; continue; }
            has_keys(e, "a distribution", "law std"); double deviation = number_of(get(e, "std"), "std");
            bad(!(deviation > 0), "header: a deviation is not above 0");
            for (int i = 0; i < a->d; i++) a->N[i * a->k + k] = mul(a->N[i * a->k + k], point(deviation));
        }
    }
    if (get(table, "noise_scale")) not_covered = 1;
    if (get(table, "shared_noise")) {
        columns = -1; noise = matrix_of(table, "shared_noise", a->d, &columns);
        a->K = columns, a->M = room((size_t)(a->d * a->K), sizeof(I));
        for (k = 0; k < a->d * a->K; k++) a->M[k] = point(noise[k]);
    }
    bad(get(table, "dynamics") ? get(table, "A") || get(table, "B") || get(table, "c") : !get(table, "A") ||
        !get(table, "B") || !get(table, "c"), "header: an agent has either `dynamics` or `A`, `B`, and `c`");
}

static void read_expressions(const Json *table, Agent *a) {
    const Json *list = get_list(table, "outputs", -1), *e; int k = 0, columns;
    a->p = list->count, a->y = room((size_t)a->p, sizeof *a->y), a->f = room((size_t)a->d, sizeof *a->f);
    for (e = list->first; e; e = e->next) parse_expression(text_of(e, "outputs"), a, &a->y[k++], 1);
    if (get(table, "dynamics")) {
        for (e = get_list(table, "dynamics", a->d)->first, k = 0; e; e = e->next)
            parse_expression(text_of(e, "dynamics"), a, &a->f[k++], 0);
        return;
    }
    a->A = matrix_of(table, "A", a->d, (columns = a->d, &columns));
    a->B = matrix_of(table, "B", a->d, (columns = a->m, &columns)); a->c = numbers_of(table, "c", a->d);
    for (k = 0; k < a->d; k++) {
        ex_tape = &a->f[k]; int sum = ex_op(NUM, -1, -3, a->c[k]);
        for (int j = 0; j < a->d + a->m; j++) {
            double x = j < a->d ? a->A[k * a->d + j] : a->B[k * a->m + j - a->d];
            if (x != 0) sum = ex_op(ADD, sum, ex_op(MUL, ex_op(NUM, -1, -3, x), ex_op(VAR, j, -1, 0), 0), 0);
        }
    }
}

static int *wholes_in(const Json *table, const char *key, int count, long low, long high) {
    const Json *list = get_list(table, key, count); int *values = room((size_t)list->count, sizeof *values), k = 0;
    for (const Json *e = list->first; e; e = e->next) values[k++] = (int)whole_of(e, key, low, high);
    return values;
}

static void read_problem(const Json *problem) {
    has_keys(problem, "`problem`", "horizon agents regions pairs task");
    T = whole_of(get(problem, "horizon"), "horizon", 1, 10000);
    const Json *list = get_list(problem, "agents", -1), *e; int k, j, K = -1, n = 0;
    bad(!(agent_count = list->count), "header: there is no agent");
    agents = room((size_t)agent_count, sizeof *agents);
    for (e = list->first, k = 0; e; e = e->next, k++) {
        read_agent(e, &agents[k]);
        for (j = 0; j < k; j++) bad(!strcmp(agents[j].name, agents[k].name), "header: two agents have one name");
        bad(k && K != agents[k].K, "header: `shared_noise` is not of the same length for all agents");
        K = agents[k].K;
    }
    for (e = list->first, k = 0; e; e = e->next) read_expressions(e, &agents[k++]);
    list = get_list(problem, "regions", -1);
    region_count = list->count, regions = room((size_t)region_count, sizeof *regions);
    char **names = room((size_t)region_count + (size_t)get_list(problem, "pairs", -1)->count, sizeof *names);
    for (e = list->first, k = 0; e; e = e->next, k++) {
        Region *r = &regions[k]; has_keys(e, "a region", "name agent low high");
        names[n++] = r->name = name_of(get(e, "name"), "name");
        r->agent = (int)whole_of(get(e, "agent"), "agent", 0, agent_count - 1);
        r->low = corner_of(get(e, "low"), agents[r->agent].p, -INFINITY, &r->moves_low);
        r->high = corner_of(get(e, "high"), agents[r->agent].p, INFINITY, &r->moves_high);
    }
    list = get(problem, "pairs"); pair_count = list->count, pairs = room((size_t)pair_count, sizeof *pairs);
    for (e = list->first, k = 0, j = 0; e; e = e->next, k++) {
        Pair *r = &pairs[k]; int disc = e->kind == TABLE && get(e, "radius") != NULL;
        has_keys(e, "a pair", disc ? "name agents outputs radius" : "name agents outputs low high");
        names[n++] = r->name = name_of(get(e, "name"), "name");
        int *both = wholes_in(e, "agents", 2, 0, agent_count - 1);
        bad(both[0] == both[1], "header: a pair is of one agent"); const Json *outputs = get_list(e, "outputs", 2);
        bad(outputs->first->kind != LIST || outputs->last->kind != LIST ||
            outputs->first->count != outputs->last->count || !(r->n = outputs->first->count),
            "header: a pair has no outputs, or not as many of either agent");
        for (int s = 0; s < 2; s++) {
            const Json *side = s ? outputs->last : outputs->first;
            r->agent[s] = both[s], r->output[s] = room((size_t)r->n, sizeof(int)); int i = 0;
            for (const Json *o = side->first; o; o = o->next)
                r->output[s][i++] = (int)whole_of(o, "outputs", 0, agents[both[s]].p - 1);
        }
        r->at = j, j += r->n;
        if (disc) {
            const Json *radius = get(e, "radius"); r->moves_low = radius->kind == LIST;
            if (r->moves_low) {
                r->radius = numbers_of(e, "radius", (int)T + 1);
            } else r->radius = room(1, sizeof(double)), *r->radius = number_of(radius, "radius");
        } else {
            r->low = corner_of(get(e, "low"), r->n, -INFINITY, &r->moves_low);
            r->high = corner_of(get(e, "high"), r->n, INFINITY, &r->moves_high);
        }
    }
    P = region_count + pair_count; no(P > 10000, "there are too many propositions for this checker");
    for (k = 0; k < n; k++) /* n is P */
        if (find_name(names, k, names[k]) >= 0) stop(UNREADABLE, "header: two propositions have the name `%s`",
            names[k]);
    const Json *task = get(problem, "task"), *automaton; has_keys(task, "`task`", "semantics automaton formula?");
    const char *semantics = text_of(get(task, "semantics"), "semantics"); cosafe = !strcmp(semantics, "co-safe");
    bad(!cosafe && strcmp(semantics, "finite-trace"), "header: unknown semantics");
    if (get(task, "formula")) formula_text = text_of(get(task, "formula"), "formula");
    has_keys(automaton = get(task, "automaton"), "`automaton`", "initial accepting root variable low high");
    list = get_list(automaton, "accepting", -1); bad(!(Q = list->count), "header: the automaton has no state");
    accepting = room((size_t)Q, sizeof(int));
    for (e = list->first, k = 0; e; e = e->next) {
        bad(e->kind != TRUTH, "header: `accepting` has something else than truth values"); accepting[k++] = e->truth;
    }
    initial = (int)whole_of(get(automaton, "initial"), "initial", 0, Q - 1);
    nodes = get_list(automaton, "variable", -1)->count; avar = wholes_in(automaton, "variable", nodes, 0, P - 1);
    aroot = wholes_in(automaton, "root", Q, -Q, nodes - 1);
    alow = wholes_in(automaton, "low", nodes, -Q, nodes - 1),
        ahigh = wholes_in(automaton, "high", nodes, -Q, nodes - 1);
    for (k = 0; k < nodes; k++)
        bad((alow[k] >= 0 && avar[alow[k]] <= avar[k]) || (ahigh[k] >= 0 && avar[ahigh[k]] <= avar[k]),
            "header: a child in the automaton tests no larger proposition");
}

/* ---- formula against automaton ---- */

/* Decision diagrams: variables below P are propositions, P + a is the atom a, "this formula holds from the next letter
 * on". 0 is false and 1 is true. */
typedef struct { int var, lo, hi; } Node;
static List node_list, fm_list, atom_list;
#define NODES ((Node *)node_list.data)

typedef struct { uint64_t key, key2; int value; } Entry;
typedef struct { Entry *entries; size_t room, count; } Map;

static int *map_at(Map *map, uint64_t key, uint64_t key2, int *new) { /* the value of a key; *new: it was not there */
    if (2 * map->count >= map->room) {
        Map larger = {NULL, map->room ? 2 * map->room : 4096, 0};
        no(larger.room > (size_t)1 << 26, "the formula is too large for this checker");
        no(!(larger.entries = calloc(larger.room, sizeof(Entry))), "memory is short");
        for (size_t k = 0; k < map->room; k++)
            if (map->entries[k].key) *map_at(&larger, map->entries[k].key, map->entries[k].key2,
                new) = map->entries[k].value;
        free(map->entries);
        *map = larger;
    }
    uint64_t h = (key * 0x9E3779B97F4A7C15u) ^ (key2 * 0xC2B2AE3D27D4EB4Fu);
    size_t k = (h ^ h >> 29) & (map->room - 1);
    for (; map->entries[k].key; k = (k + 1) & (map->room - 1))
        if (map->entries[k].key == key && map->entries[k].key2 == key2) return *new = 0, &map->entries[k].value;
    map->entries[k].key = key, map->entries[k].key2 = key2, map->count++;
    *new = 1;
    return &map->entries[k].value;
}
static uint64_t two(int a, int b) { return ((uint64_t)(uint32_t)(a + 1) << 32 | (uint32_t)b) + 1; }

static int node_of(int var, int lo, int hi) {
    static Map unique;
    int new;
    if (lo == hi) return lo;
    int *value = map_at(&unique, two(var, lo), (uint64_t)hi, &new);
    if (new) {
        *value = (int)node_list.count;
        no(node_list.count > 30000000, "the formula is too large for this checker");
        *(Node *)more(&node_list, sizeof(Node)) = (Node){var, lo, hi};
    }
    return *value;
}
static int ite(int f, int g, int h) {
    static Map cache;
    int new;
    if (f < 2) return f ? g : h;
    if (g == h) return g;
    if (g == 1 && h == 0) return f;
    int *known = map_at(&cache, two(f, g), (uint64_t)h, &new);
    if (!new) return *known;
    int var = NODES[f].var;
    if (NODES[g].var < var) var = NODES[g].var;
    if (NODES[h].var < var) var = NODES[h].var;
#define HALF(x, side) (NODES[x].var == var ? NODES[x].side : (x))
    int lo = ite(HALF(f, lo), HALF(g, lo), HALF(h, lo)), hi = ite(HALF(f, hi), HALF(g, hi), HALF(h, hi));
    int result = node_of(var, lo, hi);
    *map_at(&cache, two(f, g), (uint64_t)h, &new) = result;
    return result;
}

/* op: 1 true, p a proposition, or a character; high -1: no end */
typedef struct { int op, a, b, low, high, meaning; } Formula;
typedef struct { int formula, weak; } Atom;
#define FORMULAS ((Formula *)fm_list.data)

static int formula_of(int op, int a, int b, int low, int high) {
    static Map known;
    int new;
    int *value = map_at(&known, two(op, a), two(b, low) ^ ((uint64_t)(uint32_t)(high + 2) * 0x100000001B3u) << 8, &new);
    if (new) {
        *value = (int)fm_list.count;
        *(Formula *)more(&fm_list, sizeof(Formula)) = (Formula){op, a, b, low, high, -1};
    }
    Formula *f = FORMULAS + *value;
    no(f->op != op || f->a != a || f->b != b || f->low != low || f->high != high, "the formula has a hash collision");
    return *value;
}
static int next_of(int formula, int weak) {
    static Map known;
    int new;
    weak = weak && !cosafe; /* infinite words have a next letter */
    int *value = map_at(&known, two(formula, weak), 1, &new);
    if (new) {
        *value = (int)atom_list.count;
        no(atom_list.count > 10000, "the formula is too large for this checker");
        *(Atom *)more(&atom_list, sizeof(Atom)) = (Atom){formula, weak};
    }
    return node_of(P + *value, 0, 1);
}
/* What a formula says of this letter and of the rest of the word. */
static int meaning_of(int k) {
    Formula f = FORMULAS[k]; int result, a, b;
    if (f.meaning >= 0) return f.meaning;
    switch (f.op) {
    case '1': result = 1; break;
    case 'p': result = node_of(f.a, 0, 1); break;
    case '!': result = ite(meaning_of(f.a), 0, 1); break;
    case '&': a = meaning_of(f.a), result = ite(a, meaning_of(f.b), 0); break;
    case '|': a = meaning_of(f.a), result = ite(a, 1, meaning_of(f.b)); break;
    case '=': a = meaning_of(f.a), b = meaning_of(f.b), result = ite(a, b, ite(b, 0, 1)); break;
    case 'X': case 'N':
        if (f.low == 0) result = meaning_of(f.a);
        else result = next_of(f.low == 1 ? f.a : formula_of(f.op, f.a, -1, f.low - 1, 0), f.op == 'N');
        break;
    case 'F': case 'G': {
        int weak = f.op == 'G';
        if (f.low > 0) {
            result = next_of(formula_of(f.op, f.a, -1, f.low - 1, f.high < 0 ? -1 : f.high - 1), weak); break;
        }
        a = meaning_of(f.a);
        b = f.high == 0 ? weak : next_of(f.high < 0 ? k : formula_of(f.op, f.a, -1, 0, f.high - 1), weak);
        result = weak ? ite(a, b, 0) : ite(a, 1, b); break;
    }
    default: { /* U R W M */
        int weak = f.op == 'R' || f.op == 'W', next = next_of(k, weak); a = meaning_of(f.a), b = meaning_of(f.b);
        if (f.op == 'U' || f.op == 'W') result = ite(b, 1, ite(a, next, 0));
        else result = ite(b, ite(a, 1, next), 0);
    }
    }
    return FORMULAS[k].meaning = result;
}

static const char *fm; /* where the parser of formulas is */
static int fm_depth;
static int fm_blanks(const char *word) { /* whether this stands next; then it is read */
    while (*fm == ' ') fm++;
    size_t n = strlen(word);
    if (!n || strncmp(fm, word, n)) return 0;
    if (isalpha((unsigned char)*word) && (isalnum((unsigned char)fm[n]) || fm[n] == '_')) return 0;
    return fm += n, 1;
}
static int fm_whole(void) {
    long n = 0; fm_blanks(""); bad(!isdigit((unsigned char)*fm), "the formula has a bound that is no whole number");
    for (; isdigit((unsigned char)*fm); fm++)
        no((n = 10 * n + (*fm - '0')) > 100000, "the formula has a bound above 100000");
    return (int)n;
}
static int fm_binary(int level) { /* 0 <->, 1 ->, 2 |, 3 &, 4 U R W M, 5 unary */
    int a, b, low = 0, high = -1; bad(++fm_depth > 3000, "the formula is too deep");
    if (level < 5) {
        a = fm_binary(level + 1);
        for (;;) {
            if (level == 0 && fm_blanks("<->")) b = fm_binary(1), a = formula_of('=', a, b, 0, 0);
            else if (level == 1 && fm_blanks("->")) b = fm_binary(1),
                a = formula_of('|', formula_of('!', a, -1, 0, 0), b, 0, 0);
            else if (level == 2 && fm_blanks("|")) b = fm_binary(3), a = formula_of('|', a, b, 0, 0);
            else if (level == 3 && fm_blanks("&")) b = fm_binary(4), a = formula_of('&', a, b, 0, 0);
            else if (level == 4 && (fm_blanks("U") || fm_blanks("R") || fm_blanks("W") || fm_blanks("M"))) {
                int op = fm[-1]; b = fm_binary(4), a = formula_of(op, a, b, 0, -1);
            } else return fm_depth--, a;
        }
    }
    if (fm_blanks("!")) a = formula_of('!', fm_binary(5), -1, 0, 0);
    else if (fm_blanks("(")) {
        a = fm_binary(0); bad(!fm_blanks(")"), "the formula lacks a bracket");
    } else if (fm_blanks("X") || fm_blanks("N") || fm_blanks("F") || fm_blanks("G")) {
        int op = fm[-1], bounded = fm_blanks("[");
        if (op == 'X' || op == 'N') low = 1, high = 0;
        if (bounded) {
            bad(op == 'N', "the formula has a bound on N"); high = fm_whole();
            if (op == 'X') low = high, high = 0;
            else if (fm_blanks(",")) low = high, high = fm_whole();
            bad(!fm_blanks("]") || (op != 'X' && low > high), "the formula has a wrong bound");
        }
        a = formula_of(op, fm_binary(5), -1, low, high);
    } else if (fm_blanks("true")) a = formula_of('1', -1, -1, 0, 0);
    else if (fm_blanks("false")) a = formula_of('!', formula_of('1', -1, -1, 0, 0), -1, 0, 0);
    else {
        const char *first = fm;
        while (isalnum((unsigned char)*fm) || *fm == '_') fm++;
        for (a = 0; a < P; a++) {
            const char *name = a < region_count ? regions[a].name : pairs[a - region_count].name;
            if (strlen(name) == (size_t)(fm - first) && !strncmp(name, first, strlen(name))) break;
        }
        if (a == P) stop(UNREADABLE, "the formula has the unknown name `%.*s`", (int)(fm - first), first);
        a = formula_of('p', a, -1, 0, 0);
    }
    return fm_depth--, a;
}

/* An obligation, a function of atoms, put as what it says of the next letter and of the rest after it. */
static int expanded(int x) {
    static Map cache;
    int new;
    if (x < 2) return x;
    int *known = map_at(&cache, two(x, 0), 1, &new);
    if (!new) return *known;
    int meaning = meaning_of(((Atom *)atom_list.data)[NODES[x].var - P].formula);
    int lo = expanded(NODES[x].lo), hi = expanded(NODES[x].hi), result = ite(meaning, hi, lo);
    *map_at(&cache, two(x, 0), 1, &new) = result;
    return result;
}
static int at_end(int x) { /* whether an obligation is met by no more letters */
    while (x > 1) x = ((Atom *)atom_list.data)[NODES[x].var - P].weak ? NODES[x].hi : NODES[x].lo;
    return x;
}
/* Whether all infinite words meet an obligation, seen from diagrams that become true after some letters on every way. */
static int valid(int x, int depth) {
    static Map seen; /* 0 on the way, 1 yes, 2 no */
    int new;
    if (x < 2) return x;
    if (depth > 2000) return 0;
    int *known = map_at(&seen, two(x, 0), 1, &new);
    if (!new) return *known == 1;
    int answer;
    if (NODES[x].var < P) answer = valid(NODES[x].lo, depth + 1) && valid(NODES[x].hi, depth + 1);
    else answer = valid(expanded(x), depth + 1);
    *map_at(&seen, two(x, 0), 1, &new) = answer ? 1 : 2;
    return answer;
}

static char *live; /* states from which an accepting one can be reached */
static void find_live(void) {
    char *node_live = room((size_t)nodes, 1); live = room((size_t)Q, 1);
    for (int q = 0; q < Q; q++) live[q] = (char)accepting[q];
#define LIVE(e) ((e) < 0 ? live[-1 - (e)] : node_live[e])
    for (int changed = 1; changed;) {
        changed = 0;
        for (int k = nodes - 1; k >= 0; k--)
            if (!node_live[k] && (LIVE(alow[k]) || LIVE(ahigh[k]))) node_live[k] = 1, changed = 1;
        for (int q = 0; q < Q; q++) if (!live[q] && LIVE(aroot[q])) live[q] = 1, changed = 1;
    }
}

typedef struct { int q, obligation; } Way;
static List ways;
static Map way_seen, walk_seen;

static void reached(int q, int obligation) {
    int new;
    if (!live[q]) return;
    no(accepting[q] && (cosafe ? !valid(obligation, 0) : !at_end(obligation)),
        "the automaton accepts a word for which the formula is not proved");
    if (cosafe && accepting[q]) return;
    map_at(&way_seen, two(q, obligation), 2, &new);
    if (new) *(Way *)more(&ways, sizeof(Way)) = (Way){q, obligation};
}
static void walk(int e, int x) { /* all letters from an entry of the automaton and a diagram of the formula on */
    int new, a = e < 0 ? P : avar[e], b = x < 2 ? P : NODES[x].var;
    if (a == P && b >= P) { reached(-1 - e, x); return; }
    map_at(&walk_seen, two(e, x), 3, &new);
    if (!new) return;
    int var = a < b ? a : b; walk(a == var ? alow[e] : e, b == var ? NODES[x].lo : x);
    walk(a == var ? ahigh[e] : e, b == var ? NODES[x].hi : x);
}
static void check_formula(void) {
    *(Node *)more(&node_list, sizeof(Node)) = (Node){INT_MAX, 0, 0};
    *(Node *)more(&node_list, sizeof(Node)) = (Node){INT_MAX, 1, 1};
    fm = formula_text; int formula = fm_binary(0); fm_blanks(""); bad(*fm, "the formula is not well written");
    find_live();
    /* before any letter the obligation is the formula itself */
    int start = next_of(formula, 0);
    no(accepting[initial] && cosafe && !valid(start, 0), "the automaton accepts before any letter");
    if (accepting[initial] && cosafe) return;
    walk(aroot[initial], expanded(start));
    for (size_t k = 0; k < ways.count; k++) {
        Way way = ((Way *)ways.data)[k]; walk(aroot[way.q], expanded(way.obligation));
    }
}

/* ---- letters ---- */

/* What is known of a proposition: 1 it holds, 0 it does not, 2 nothing. From automaton states on, all letters. */
static void read_letter(int e, const char *known, char *next, char *seen) {
    if (e < 0) { next[-1 - e] = 1; return; }
    if (seen[e]) return;
    seen[e] = 1;
    if (known[avar[e]] != 1) read_letter(alow[e], known, next, seen);
    if (known[avar[e]] != 0) read_letter(ahigh[e], known, next, seen);
}
static char box_holds(I y, double low, double high) { return y.lo >= low && y.hi < high ? 1 : y.hi < low ||
    y.lo >= high ? 0 : 2; }

static char pair_holds(const Pair *r, long t, I *const *y) {
    char all = 1; I sum = ZERO, radius = r->radius ? point(pair_radius(r, t)) : ZERO;
    for (int k = 0; k < r->n; k++) {
        I z = sub(y[r->agent[0]][r->output[0][k]], y[r->agent[1]][r->output[1][k]]);
        if (r->radius) sum = add(sum, square(z));
        else {
            char one = box_holds(z, pair_low(r, t, k), pair_high(r, t, k));
            all = all == 0 || one == 0 ? 0 : all == 2 || one == 2 ? 2 : 1;
        }
    }
    if (!r->radius) return all;
    if (radius.lo <= 0) return 0;
    return sum.hi < square(radius).lo ? 1 : sum.lo >= square(radius).hi ? 0 : 2;
}
static int region_empty(const Region *r, long t) {
    for (int k = 0; k < agents[r->agent].p; k++) if (region_low(r, t, k) >= region_high(r, t, k)) return 1;
    return 0;
}
static int pair_empty(const Pair *r, long t) {
    if (r->radius) return pair_radius(r, t) <= 0;
    for (int k = 0; k < r->n; k++) if (pair_low(r, t, k) >= pair_high(r, t, k)) return 1;
    return 0;
}
static int regions_apart(const Region *a, const Region *b, long t) {
    if (a->agent != b->agent) return 0;
    for (int k = 0; k < agents[a->agent].p; k++)
        if (region_high(a, t, k) <= region_low(b, t, k) || region_high(b, t, k) <= region_low(a, t, k)) return 1;
    return 0;
}

/* ---- proofs along trajectories ---- */

typedef struct { double *u, *K, *x, *w; int at, source; } Path; /* at: of the first state in joint vectors */
static Path *paths;
static int D, own_sources, sources;
static long S;
static double *shift, *radius_of, *Fs; /* m and R of step s at [s D + k]; F of step s at [(s D + k) D + j] */
static char *named; /* whether dynamics of agent i name agent j */

typedef struct { /* a row of the linear error at one time */
    double *c;
    I rest; /* everything in c e that is not noise */
    double deviation, below, above; int source;
    I *moved; long t; /* what each source adds at each step before time t, at [s sources + j] */
} Row;
static List rows;
static int *group;

static int group_of(int k) {
    while (group[k] != k) k = group[k] = group[group[k]];
    return k;
}

/* A row c, whose entries are of all agents, at time t. */
static void follow(const double *c, long t, Row *row) {
    size_t mark = block_count; I *y = room((size_t)D, sizeof *y), *next = room((size_t)D, sizeof *y), variance = ZERO;
    row->source = -1, row->rest = ZERO;
    for (int k = 0; k < D; k++) y[k] = point(c[k]);
#define FROM(column) \
    (row->source < 0 ? (row->source = group_of(column)) : (group[group_of(column)] = group_of(row->source)))
    for (long s = t - 1; s >= 0; s--) {
        for (int k = 0; k < D; k++)
            if (!is_zero(y[k])) row->rest = add(row->rest, mul(y[k], (I){dn(shift[s * D + k] - radius_of[s * D + k]),
                                                                         up(shift[s * D + k] + radius_of[s * D + k])}));
        for (int shared = 0; shared < 2; shared++)
            for (int i = 0; i < (shared ? 1 : agent_count); i++)
                for (int j = 0; j < (shared ? sources - own_sources : agents[i].k); j++) {
                    I sum = ZERO;
                    for (int a = shared ? 0 : i; a < (shared ? agent_count : i + 1); a++)
                        for (int k = 0; k < agents[a].d; k++)
                            if (!is_zero(y[paths[a].at + k]) && (!shared || agents[a].M))
                                sum = add(sum, mul(y[paths[a].at + k], shared ? agents[a].M[k * agents[a].K + j]
                                                                             : agents[a].N[k * agents[a].k + j]));
                    if (is_zero(sum)) continue;
                    row->moved[s * sources + (shared ? own_sources : paths[i].source) + j] = sum;
                    variance = add(variance, square(sum)); FROM(shared ? own_sources + j : paths[i].source + j);
                }
        for (int k = 0; k < D; k++) next[k] = ZERO;
        for (int i = 0; i < agent_count; i++)
            for (int j = 0; j < agent_count; j++)
                if (named[i * agent_count + j])
                    for (int k = paths[i].at; k < paths[i].at + agents[i].d; k++)
                        if (!is_zero(y[k]))
                            for (int l = paths[j].at; l < paths[j].at + agents[j].d; l++)
                                if (Fs[(s * D + k) * D + l] != 0)
                                    next[l] = add(next[l], mul(y[k], point(Fs[(s * D + k) * D + l])));
        I *swap = y; y = next, next = swap;
    }
    for (int i = 0; i < agent_count; i++)
        for (int k = 0; k < agents[i].d; k++) {
            I start = sub((I){agents[i].start_low[k], agents[i].start_high[k]}, point(paths[i].x[k]));
            row->rest = add(row->rest, mul(y[paths[i].at + k], is_zero(start) ? ZERO : around(mag(start))));
        }
    row->deviation = is_zero(variance) ? 0 : root(variance).hi; release(mark);
}
/* The row at the time that is looked at: rows on the same form are one. */
static Row *row_of(const double *c, long t, size_t first) {
    for (size_t k = first; k < rows.count; k++) {
        Row *row = (Row *)rows.data + k;
        if (!memcmp(row->c, c, (size_t)D * sizeof *c)) return row;
    }
    Row *row = more(&rows, sizeof(Row)); row->c = room((size_t)D, sizeof *c);
    for (int k = 0; k < D; k++) row->c[k] = c[k] == 0 ? 0 : c[k];
    row->t = t; row->moved = room((size_t)(t * sources) + 1, sizeof(I));
    row->below = row->above = INFINITY; follow(c, t, row); return row;
}
/* low <= value + c e < high with a value that is known up to an interval */
static void ask(Row *row, I value, double low, double high) {
    I at = add(value, row->rest);
    if (low > -INFINITY) row->below = least(row->below, dn(at.lo - low));
    if (high < INFINITY) row->above = least(row->above, dn(high - at.hi));
}

static void add_product(I *sum, I a, I b) { *sum = add(*sum, mul(a, b)); }

/* What f(z + L e + rho) - value(z) - F e may be, all of F exact: z the nominal point of n variables, `box` around them
 * all that they may be, L (n, E) from errors e in `errors`, rho what inputs are rounded by. The mean value form and two
 * of Taylor's, met. */
static I remainder_of(const Tape *f, int n, const I *z, const I *box, int E, const double *L, const I *errors,
    const double *rho, const double *F, double time, I *value) {
    size_t mark = block_count;
    I *near = room(1 + (size_t)(n + n * (n + 1) / 2), sizeof(I)),
        *wide = room(1 + (size_t)(n + n * (n + 1) / 2), sizeof(I));
    undefined = 0; evaluate(f, z, n, 1, time, near);
    if (undefined) stop(REFUSED, "an expression has no value on the trajectory at time %g", time);
    *value = near[0];
    undefined = 0; evaluate(f, box, n, 2, time, wide);
    if (undefined) { release(mark); return ALL; }
    I *move = room((size_t)n, sizeof(I)), *middle = room((size_t)(n * n), sizeof(I)),
        *HL = room((size_t)(n * E), sizeof(I));
    I mean = ZERO, taylor = ZERO;
    for (int v = 0; v < n; v++) {
        move[v] = box[v].lo == z[v].lo && box[v].hi == z[v].hi ? ZERO : sub(box[v], z[v]);
        move[v] = hull(move[v], ZERO); add_product(&mean, wide[1 + v], around(rho[v]));
        add_product(&taylor, near[1 + v], around(rho[v]));
    }
    for (int e = 0; e < E; e++) {
        I g = point(-F[e]), j = point(-F[e]);
        for (int v = 0; v < n; v++)
            if (L[v * E + e] != 0) add_product(&g, wide[1 + v], point(L[v * E + e])),
                add_product(&j, near[1 + v], point(L[v * E + e]));
        add_product(&mean, g, errors[e]); add_product(&taylor, j, errors[e]);
    }
    I bent = taylor; /* second derivatives by all variables, with the boxes of these */
    double curved = 0; /* what second derivatives are off their middles by, and what rho adds */
    for (int i = 0, h = 1 + n; i < n; i++)
        for (int j = 0; j <= i; j++, h++) {
            if (is_zero(wide[h])) continue;
            add_product(&bent, wide[h], i == j ? mul(point(0.5), square(move[i])) : mul(move[i], move[j]));
            double m = 0.5 * wide[h].lo + 0.5 * wide[h].hi;
            if (!isfinite(m)) m = 0;
            double r = most(up(wide[h].hi - m), up(m - wide[h].lo)), a = mag(move[i]), b = mag(move[j]),
                H = mag(wide[h]);
            if (wide[h].lo == wide[h].hi) r = 0;
            middle[i * n + j] = middle[j * n + i] = point(m);
            curved = up(curved + up(times(times(i == j ? 0.5 * r : r, a), b) * (1 + 1e-15)));
            curved = up(curved + up(times(H, up(up(rho[i] * b) + up(rho[j] * a))) * (1 + 1e-15)));
        }
    for (int v = 0; v < n; v++)
        for (int e = 0; e < E; e++)
            for (int w = 0; w < n; w++)
                if (L[w * E + e] != 0) add_product(&HL[v * E + e], middle[v * n + w], point(L[w * E + e]));
    for (int a = 0; a < E; a++)
        for (int b = 0; b <= a; b++) {
            I q = ZERO;
            for (int v = 0; v < n; v++) if (L[v * E + a] != 0) add_product(&q, HL[v * E + b], point(L[v * E + a]));
            if (is_zero(q)) continue;
            if (a == b) add_product(&taylor, mul(point(0.5), q), square(errors[a]));
            else add_product(&taylor, q, mul(errors[a], errors[b]));
        }
    if (!isnan(curved)) taylor = add(taylor, around(curved));
    else taylor = ALL;
    release(mark); return meet(mean, meet(taylor, bent));
}

static double *doubles(size_t n) { return room(n, sizeof(double)); }

static void check_trajectory(const Json *proof) {
    has_keys(proof, "`proof`", "kind letters faces normals agents");
    const Json *list = get_list(proof, "agents", agent_count), *e; int i, j, k, l, normals_width = 0, top = 0;
    const Array *a = array_of(get(proof, "letters"), "letters", 'i', 2, -1, P, 0); S = a->shape[0] - 1;
    if (S < 1 || S > T || (!cosafe && S != T)) stop(REFUSED, "the trajectory has %ld steps of %ld", S, T);
    long *letters = wholes_of(a, "letters", -1, 2);
    long *faces = wholes_of(array_of(get(proof, "faces"), "faces", 'i', 2, S + 1, P, 0), "faces", -1, LONG_MAX);
    for (k = 0; k < pair_count; k++) normals_width += pairs[k].n;
    double *normals = reals_of(array_of(get(proof, "normals"), "normals", 'f', 2, S + 1, normals_width, 0), "normals",
        0);
    paths = room((size_t)agent_count, sizeof *paths);
    for (e = list->first, i = 0; e; e = e->next, i++) {
        Agent *agent = &agents[i]; Path *p = &paths[i]; int d = agent->d, m = agent->m;
        has_keys(e, "an agent of `proof`", "inputs gains states widths noise_widths? network? feedback? radius?");
        if (get(e, "network") || get(e, "feedback")) stop(NOT_COVERED, "policies that were given");
        if (get(e, "noise_widths"))
            reals_of(array_of(get(e, "noise_widths"), "noise_widths", 'f', 2, S, d, 0), "noise_widths", 1);
        p->u = reals_of(array_of(get(e, "inputs"), "inputs", 'f', 2, S, m, 0), "inputs", 0);
        p->K = reals_of(array_of(get(e, "gains"), "gains", 'f', 3, S, m, d), "gains", 0);
        p->x = reals_of(array_of(get(e, "states"), "states", 'f', 2, S + 1, d, 0), "states", 0);
        p->w = reals_of(array_of(get(e, "widths"), "widths", 'f', 2, S + 1, d + m, 0), "widths", 1);
        p->at = D, p->source = own_sources; D += d, own_sources += agent->k, top = agent->K > top ? agent->K : top;
        for (long s = 0; s <= S; s++)
            for (k = 0; k < d + m; k++) {
                if (k >= d && s == S) continue;
                double x = k < d ? p->x[s * d + k] : p->u[s * m + k - d];
                if (x < (k < d ? agent->state_low[k] : agent->input_low[k - d]) ||
                    x > (k < d ? agent->state_high[k] : agent->input_high[k - d]))
                    stop(REFUSED, "a nominal state or input of `%s` is outside its box", agent->name);
            }
        for (long s = 0; s < (S + 1) * (d + m); s++)
            if (p->w[s] < 0) stop(REFUSED, "a width of `%s` is below 0", agent->name);
        int flat = 1, off = 0;
        for (k = 0; k < d; k++) {
            flat &= agent->start_low[k] == agent->start_high[k];
            off |= agent->start_low[k] > p->x[k] || agent->start_high[k] < p->x[k];
        }
        if (flat && off) stop(REFUSED, "the start of `%s` is not its first nominal state", agent->name);
    }
    for (k = 0; k < array_count; k++) if (!arrays[k].named) stop(UNREADABLE, "array %d has no name", k);
    for (long s = 0; s < (S + 1) * P; s++)
        if (letters[s] == 2) stop(NOT_COVERED, "a region is crossed within a window");
    sources = own_sources + top; group = room((size_t)sources + 1, sizeof *group);
    for (k = 0; k < sources; k++) group[k] = k;
    shift = doubles((size_t)(S * D)), radius_of = doubles((size_t)(S * D));
    no(D > 20000, "there are too many states for this checker"); Fs = doubles((size_t)S * (size_t)D * (size_t)D);
    named = room((size_t)agent_count * (size_t)agent_count, 1);
    for (i = 0; i < agent_count; i++) {
        named[i * agent_count + i] = 1;
        for (k = 0; k < agents[i].others; k++) named[i * agent_count + agents[i].other[k].agent] = 1;
    }
    char *known = room((size_t)P, 1), *now = room((size_t)Q, 1), *next = room((size_t)Q, 1),
        *seen = room((size_t)nodes, 1);
    I **y = room((size_t)agent_count, sizeof *y);
    for (i = 0; i < agent_count; i++) y[i] = room((size_t)agents[i].p, sizeof(I));
    now[initial] = 1; double *c = doubles((size_t)D), *C = doubles((size_t)D);
    I *error = room((size_t)D, sizeof(I)), *inputs = NULL;
    int M = 0, *input_at = room((size_t)agent_count, sizeof(int));
    for (i = 0; i < agent_count; i++) input_at[i] = M, M += agents[i].m;
    inputs = room((size_t)M, sizeof(I)); double *rho = doubles((size_t)M);

    for (long t = 0; t <= S; t++) {
        size_t first = rows.count, mark;
        /* the tube: states, then inputs */
        for (i = 0; i < agent_count; i++)
            for (k = 0; k < agents[i].d; k++) {
                memset(c, 0, (size_t)D * sizeof *c); c[paths[i].at + k] = 1;
                double x = paths[i].x[t * agents[i].d + k], w = paths[i].w[t * (agents[i].d + agents[i].m) + k];
                Row *row = row_of(c, t, first);
                I space = sub((I){agents[i].state_low[k], agents[i].state_high[k]}, point(x));
                error[paths[i].at + k] = t ? meet(space, add(row->rest, around(w))) : row->rest;
                no(error[paths[i].at + k].lo > error[paths[i].at + k].hi, "a tube is empty");
                if (!t) continue;
                ask(row, point(x), agents[i].state_low[k], agents[i].state_high[k]);
                row->below = least(row->below, w), row->above = least(row->above, w);
            }
        for (i = 0; i < agent_count && t < S; i++)
            for (j = 0; j < agents[i].m; j++) {
                int d = agents[i].d; const double *K = paths[i].K + (t * agents[i].m + j) * d;
                double u = paths[i].u[t * agents[i].m + j], w = paths[i].w[t * (d + agents[i].m) + d + j], far = 0;
                I box = {agents[i].input_low[j], agents[i].input_high[j]}, move = ZERO;
                memset(c, 0, (size_t)D * sizeof *c);
                for (k = 0; k < d; k++) {
                    c[paths[i].at + k] = K[k]; add_product(&move, point(K[k]), error[paths[i].at + k]);
                    far = up(far + up(fabs(K[k]) * up(mag(error[paths[i].at + k]) + 0x1p-53 * fabs(paths[i].x[t * d + k]))));
                    far = up(far * (1 + 0x1p-50));
                }
                rho[input_at[i] + j] = up(up(4 * (d + 3) * 0x1p-53 * up(fabs(u) + far)) * (1 + 0x1p-50));
                size_t before = rows.count; Row *row = row_of(c, t, first); inputs[input_at[i] + j] = ZERO;
                if (is_zero(row->rest) && row->deviation == 0) rows.count = before; /* no error reaches it */
                else {
                    ask(row, point(u), box.lo, box.hi);
                    if (t) row->below = least(row->below, w), row->above = least(row->above, w);
                    I tube = t ? add(row->rest, around(w)) : row->rest;
                    inputs[input_at[i] + j] = meet(meet(tube, move), sub(box, point(u)));
                    no(inputs[input_at[i] + j].lo > inputs[input_at[i] + j].hi, "a tube is empty");
                }
            }
        /* letters: rows of regions and pairs */
        for (k = 0; k < P; k++) known[k] = 2;
        for (i = 0; i < agent_count && !t; i++)
            for (k = 0; k < agents[i].p; k++) {
                I *box = room((size_t)agents[i].d, sizeof(I));
                for (j = 0; j < agents[i].d; j++) box[j] = (I){agents[i].start_low[j], agents[i].start_high[j]};
                undefined = 0; evaluate(&agents[i].y[k], box, agents[i].d, 0, 0, &y[i][k]);
                if (undefined) stop(REFUSED, "an output of `%s` has no value at a start", agents[i].name);
            }
        for (k = 0; k < P; k++) {
            const Region *r = k < region_count ? &regions[k] : NULL;
            const Pair *pair = r ? NULL : &pairs[k - region_count];
            long letter = letters[t * P + k], face = faces[t * P + k];
            if (!t) {
                no(letter, "a letter is given at time 0");
                if (pair) known[k] = pair_holds(pair, 0, y);
                else known[k] = 1;
                for (j = 0; r && j < agents[r->agent].p; j++) {
                    char one = box_holds(y[r->agent][j], region_low(r, 0, j), region_high(r, 0, j));
                    known[k] = known[k] == 0 || one == 0 ? 0 : known[k] == 2 || one == 2 ? 2 : 1;
                }
                continue;
            }
            int empty = r ? region_empty(r, t) : pair_empty(pair, t);
            if (letter) known[k] = letter == 1;
            else if (empty) known[k] = 0;
            for (j = 0; r && !letter && j < region_count; j++)
                if (letters[t * P + j] == 1 && regions_apart(r, &regions[j], t)) known[k] = 0;
            if (!letter || (letter < 0 && empty)) continue;
            no(letter == 1 && empty, "a region that is empty should hold");
            int n = r ? agents[r->agent].p : pair->n, whole = pair && (pair->radius || letter < 0), strips;
            no(r && letter < 0 && (face < 0 || face >= 2L * n), "a region has no face where it does not hold");
            strips = !whole ? n : letter < 0 ? 1 : n == 2 ? 4 : n;
            for (l = 0; l < strips; l++) {
                if (r && letter < 0 && l != face / 2) continue;
                mark = block_count; double low = -INFINITY, high = INFINITY, *direction = doubles((size_t)n);
                I value = ZERO; memset(c, 0, (size_t)D * sizeof *c);
                if (!whole) direction[l] = 1;
                else if (letter < 0) {
                    double largest = 0; I norm = ZERO, b = ZERO;
                    for (j = 0; j < n; j++) {
                        double v = direction[j] = normals[t * normals_width + pair->at + j];
                        largest = most(largest, fabs(v)), norm = add(norm, square(point(v)));
                        if (!pair->radius && v != 0) add_product(&b, point(v),
                            point(v > 0 ? pair_high(pair, t, j) : pair_low(pair, t, j)));
                    }
                    no(!(largest >= 1e-6 && largest <= 1e6), "a direction is 0, or too small or too large");
                    if (pair->radius) b = mul(root(norm), point(pair_radius(pair, t)));
                    low = b.hi; /* infinite at an open side: then nothing is far enough */
                    no(low == INFINITY, "a direction leads to an open side of a pair");
                } else if (n == 2) { /* the octagon */
                    direction[0] = l == 0 || l == 1 ? 1 : l == 3 ? -1 : 0; direction[1] = l == 0 ? 0 : 1;
                    I half = mul(cosine_of(divide(PI_HALF, point(4))), point(pair_radius(pair, t)));
                    high = mul(half, l % 2 ? root(point(2)) : ONE).lo * (1 - 1e-12), low = -high;
                } else {
                    direction[l] = 1;
                    high = divide(point(pair_radius(pair, t)), root(point(n))).lo * (1 - 1e-12), low = -high;
                }
                if (pair && !whole) low = pair_low(pair, t, l), high = pair_high(pair, t, l);
                if (r && letter > 0) low = region_low(r, t, l), high = region_high(r, t, l);
                if (r && letter < 0 && face % 2 == 0) high = region_low(r, t, l);
                if (r && letter < 0 && face % 2 == 1) low = region_high(r, t, l);
                no(isinf(low) && low > 0, "a face of a region is at an open side");
                no(isinf(high) && high < 0, "a face of a region is at an open side");
                no(r && letter < 0 && (face % 2 ? isinf(low) : isinf(high)), "a face of a region is at an open side");
                if (isinf(low) && isinf(high)) { release(mark); continue; }
                for (int side = 0; side < (pair ? 2 : 1); side++) {
                    Agent *agent = &agents[pair ? pair->agent[side] : r->agent];
                    const Path *p = &paths[agent - agents]; int d = agent->d;
                    double *L = doubles((size_t)(d * d)), *zero = doubles((size_t)d);
                    I *z = room((size_t)d, sizeof(I)), *box = room((size_t)d, sizeof(I)),
                        *near = room((size_t)d + 1, sizeof(I)), out;
                    for (j = 0; j < d; j++) {
                        z[j] = point(p->x[t * d + j]), L[j * d + j] = 1;
                        box[j] = meet(add(z[j], hull(ZERO, error[p->at + j])),
                            hull(z[j], (I){agent->state_low[j], agent->state_high[j]}));
                    }
                    for (int o = 0; o < n; o++) {
                        if (direction[o] == 0) continue;
                        const Tape *f = &agent->y[pair ? pair->output[side][o] : o]; undefined = 0;
                        evaluate(f, z, d, 1, (double)t, near);
                        for (j = 0; j < d; j++) {
                            C[j] = 0.5 * near[1 + j].lo + 0.5 * near[1 + j].hi;
                            if (!isfinite(C[j])) C[j] = 0;
                        }
                        I rest = remainder_of(f, d, z, box, d, L, error + p->at, zero, C, (double)t, &out),
                            factor = point(side ? -direction[o] : direction[o]);
                        add_product(&value, factor, add(out, rest));
                        for (j = 0; j < d; j++) { /* the row is a double: what it is off by joins the value */
                            double exact = times(factor.lo, C[j]), old = c[p->at + j], new = old + exact;
                            if (C[j] == 0) continue;
                            I off = sub(add(mul(factor, point(C[j])), point(old)), point(new));
                            if ((factor.lo == 1 || factor.lo == -1) && old == 0) off = ZERO;
                            add_product(&value, off, error[p->at + j]); c[p->at + j] = new;
                        }
                    }
                }
                ask(row_of(c, t, first), value, low, high);
            }
        }
        memset(next, 0, (size_t)Q), memset(seen, 0, (size_t)nodes);
        for (int q = 0; q < Q; q++) {
            if (!now[q]) continue;
            if (cosafe && accepting[q]) next[q] = 1;
            else read_letter(aroot[q], known, next, seen);
        }
        memcpy(now, next, (size_t)Q);
        if (t == S) break;
        /* the step: F, and what is left of it */
        for (i = 0; i < agent_count; i++) {
            mark = block_count; Agent *agent = &agents[i]; const Path *p = &paths[i];
            int d = agent->d, m = agent->m, n = d + m + agent->nd + agent->others, E = agent->nd;
            int *column = room((size_t)agent_count, sizeof(int));
            for (j = 0; j < agent_count; j++) if (named[i * agent_count + j]) column[j] = E, E += agents[j].d;
            double *L = doubles((size_t)(n * E)), *F = doubles((size_t)E), *slack = doubles((size_t)n);
            I *z = room((size_t)n, sizeof(I)), *box = room((size_t)n, sizeof(I)), *errors = room((size_t)E, sizeof(I));
            I *near = room((size_t)n + 1, sizeof(I)), value;
            for (j = 0; j < agent_count; j++)
                for (k = 0; k < agents[j].d &&
                    named[i * agent_count + j]; k++) errors[column[j] + k] = error[paths[j].at + k];
            for (int v = 0; v < n; v++) {
                int who = i, index = v, is_input = 0;
                if (v >= d + m && v < d + m + agent->nd) { /* a disturbance is an error of its own, around its middle */
                    I range = agent->disturbance[v - d - m];
                    z[v] = point(0.5 * range.lo + 0.5 * range.hi), box[v] = range;
                    errors[v - d - m] = range.lo == range.hi ? ZERO : sub(range, z[v]); L[v * E + v - d - m] = 1;
                    continue;
                }
                if (v >= d + m) {
                    const Other *o = &agent->other[v - d - m - agent->nd];
                    who = o->agent, index = o->index, is_input = o->is_input;
                } else if (v >= d) index = v - d, is_input = 1;
                const Agent *other = &agents[who]; const Path *q = &paths[who]; I move, limits;
                if (is_input) {
                    z[v] = point(q->u[t * other->m + index]); slack[v] = rho[input_at[who] + index];
                    move = add(inputs[input_at[who] + index], around(slack[v]));
                    limits = (I){other->input_low[index], other->input_high[index]};
                    if (!is_zero(inputs[input_at[who] + index]))
                        for (k = 0; k < other->d; k++) L[v * E + column[who] + k] = q->K[(t * other->m + index) * other->d + k];
                } else {
                    z[v] = point(q->x[t * other->d + index]); move = error[q->at + index];
                    limits = (I){other->state_low[index], other->state_high[index]};
                    L[v * E + column[who] + index] = 1;
                }
                box[v] = is_zero(move) ? z[v] : meet(add(z[v], hull(ZERO, move)), hull(z[v], limits));
            }
            for (k = 0; k < d; k++) {
                evaluate(&agent->f[k], z, n, 1, (double)t, near); memset(F, 0, (size_t)E * sizeof *F);
                for (int v = 0; v < n; v++)
                    for (l = 0; l < E; l++)
                        if (L[v * E + l] != 0 &&
                            l >= agent->nd) F[l] += L[v * E + l] * (0.5 * near[1 + v].lo + 0.5 * near[1 + v].hi);
                for (l = 0; l < E; l++) if (!isfinite(F[l])) F[l] = 0;
                I rest = remainder_of(&agent->f[k], n, z, box, E, L, errors, slack, F, (double)t, &value);
                rest = add(rest, sub(value, point(p->x[(t + 1) * d + k])));
                if (!(rest.hi - rest.lo < 1e150)) stop(REFUSED, "nothing bounds the remainder of `%s` at time %ld",
                    agent->name, t);
                long at = t * D + p->at + k; shift[at] = 0.5 * rest.lo + 0.5 * rest.hi;
                radius_of[at] = most(up(rest.hi - shift[at]), up(shift[at] - rest.lo));
                for (j = 0; j < agent_count; j++)
                    for (l = 0; l < agents[j].d && named[i * agent_count + j]; l++)
                        Fs[at * D + paths[j].at + l] = F[column[j] + l];
            }
            release(mark);
        }
    }
    for (int q = 0; q < Q; q++) no(now[q] && !accepting[q], "a word that agrees with the letters is not accepted");
}

/* One less a product of (1 - p), p one after the other. */
static double either(double f, double p) { return p >= 1 || f >= 1 ? 1 : least(1, up(f + up(p * up(1 - f)))); }



/* P(X > a, Y <= b) from above, for normal numbers whose correlation is at least rho: an integral over Y in pieces. */
static double beyond_both(double a, double b, double rho) {
    I one_less = mul(sub(ONE, point(rho)), add(ONE, point(rho))), r = root(one_less); double y = b, total = 0;
    I below = tail_at(-y), tail = tail_at(divide(sub(point(a), mul(point(rho), point(y))), r).lo);
    for (int k = 0; k < 64; k++) {
        double y_next = y - 0.1 * r.lo / rho; I c = divide(sub(point(a), mul(point(rho), point(y_next))), r);
        I below_next = tail_at(-y_next), tail_next = tail_at(c.lo);
        /* where the normal tail is convex, and the density falls, the mean of both ends is enough */
        int chord = y_next >= 0 && divide(sub(point(a), mul(point(rho), point(y))), r).lo >= 0;
        double q = chord ? up(0.5 * up(tail.hi + tail_next.hi)) : tail.hi;
        total = up(total + up(most(sub(below, below_next).hi, 0) * q));
        y = y_next, below = below_next, tail = tail_next;
    }
    return up(total + up(below.hi * tail.hi));
}

/* What a row adds to the failure of earlier ones at one end: it fails, and one of them holds. Of each of three times it
   is the one that holds least often where the row fails. */
static double first_failure(size_t number, int above, double plain) {
    const Row *row = (Row *)rows.data + number; double best = plain, held = INFINITY, a = 0, b = 0, rho = 0;
    if (plain <= 1e-8) return plain;
    for (size_t k = number; k-- > 0;) {
        const Row *old = (Row *)rows.data + k; I together = ZERO, alone = ZERO;
        if (old->t < row->t - 2) break;
        if (old->source < 0 || group_of(old->source) != group_of(row->source)) continue;
        for (long s = 0; s < old->t * sources; s++) {
            if (is_zero(old->moved[s])) continue;
            add_product(&alone, old->moved[s], old->moved[s]);
            if (s < row->t * sources) add_product(&together, old->moved[s], row->moved[s]);
        }
        int same = together.lo > 0; double size = same ? together.lo : -together.hi, deviation = root(alone).lo,
            end = same == above ? old->above : old->below, own = dn((above ? row->above : row->below) / row->deviation),
            r = least(dn(dn(size / up(row->deviation * old->deviation)) * (1 - 0x1p-50)), 1 - 1e-9);
        if (r > 0.1 && isfinite(end) && end >= 0 && own >= 0 && deviation > 0) {
            double z = (up(end / deviation) - r * (own + 1 / (1 + own))) / sqrt(1 - r * r);
            if (z < held) held = z, a = own, b = up(end / deviation), rho = r;
        }
        if (held < INFINITY && (k == 0 || ((Row *)rows.data + k - 1)->t < old->t))
            best = least(best, beyond_both(a, b, rho)), held = INFINITY;
    }
    return best;
}

static double failure_of_rows(void) {
    double *all = doubles((size_t)sources + 1), *strips = doubles((size_t)sources + 1),
        *left = doubles((size_t)sources + 1), *first = doubles((size_t)sources + 1), f = 0;
    for (size_t k = 0; k < rows.count; k++) {
        const Row *row = (Row *)rows.data + k;
        if (row->below == INFINITY && row->above == INFINITY) continue;
        if (row->source < 0 || row->deviation == 0) {
            no(!(row->below > 0 && row->above > 0), "a constraint without noise does not hold"); continue;
        }
        double near = dn(least(row->below, row->above) / row->deviation),
            far = dn(most(row->below, row->above) / row->deviation);
        I p = tail_at(near), q = far == INFINITY ? ZERO : tail_at(far); int g = group_of(row->source);
        /* the strip up to the near side; or that up to the far side, and what is left between them */
        all[g] = either(all[g], near > 0 ? 2 * p.hi : 1); strips[g] = either(strips[g], far > 0 ? 2 * q.hi : 1);
        left[g] = up(left[g] + up(p.hi - q.lo));
        double low = row->below < row->above ? p.hi : q.hi, high = row->below < row->above ? q.hi : p.hi;
        first[g] = up(first[g] + up(first_failure(k, 0, near > 0 ? low : 1) + first_failure(k, 1, near > 0 ? high : 1)));
    }
    for (int g = 0; g < sources; g++) f = either(f, least(1, least(least(all[g], first[g]), up(strips[g] + left[g]))));
    return f;
}

/* ---- proofs on cells ---- */

typedef struct {
    long *sizes, *lattice_sizes, cells, points, *policy, policies;
    double **edges, **lattice, *inverse, *spread, *missed; const Array *sets, *start_sets;
    double **mass; /* of axis k: mass[k][z sizes[k] + cell], from below, where a policy aims at it */
    char **aimed;
} Grid;
static Grid *grids;

typedef struct { int count; char *labels; int *class; } Labels; /* classes of cells by what their regions say */

/* What the regions of an agent say on boxes of states: 0, 1, or 2 (unknown); closed above where `closed` says so. */
static void label_of(int who, const I *box, const char *closed, char *label) {
    const Agent *a = &agents[who];
    for (int r = 0; r < region_count; r++) {
        label[r] = 1;
        if (regions[r].agent != who) continue;
        for (int k = 0; k < a->p; k++) {
            double low = region_low(&regions[r], 0, k), high = region_high(&regions[r], 0, k); I y; undefined = 0;
            evaluate(&a->y[k], box, a->d, 0, 0, &y);
            if (undefined) y = ALL;
            char one = box_holds(y, low, high); int bare = a->y[k].bare;
            if (bare >= 0 && !closed[bare]) one = y.lo >= low && y.hi <= high ? 1 : y.hi <= low || y.lo >= high ? 0 : 2;
            label[r] = label[r] == 0 || one == 0 ? 0 : label[r] == 2 || one == 2 ? 2 : 1;
        }
    }
}
static void classify(Labels *labels, long cell, const char *label) {
    int k = 0;
    while (k < labels->count && memcmp(labels->labels + k * region_count, label, (size_t)region_count)) k++;
    if (k == labels->count) {
        no(k >= 2000, "there are too many kinds of cells for this checker"); labels->count++;
        memcpy(labels->labels + k * region_count, label, (size_t)region_count);
    }
    labels->class[cell] = k;
}
static long walk_steps;
/* Whether all letters of the classes that are alive lead from an entry to a state, or to acceptance. */
static void walk_cells(int e, int target, const Labels *labels, char **alive) {
    no(++walk_steps > 5000000, "guards have too many letters for this checker");
    if (e < 0) {
        no(-1 - e != target && !(cosafe && accepting[-1 - e]), "a letter does not lead where its guard says"); return;
    }
    int who = regions[avar[e]].agent, count = labels[who].count; char *old = alive[who]; size_t mark = block_count;
    for (int value = 0; value < 2; value++) {
        int any = 0; char *new = room((size_t)count, 1);
        for (int k = 0; k < count; k++) {
            char said = labels[who].labels[k * region_count + avar[e]];
            any |= new[k] = old[k] && (said == 2 || said == value);
        }
        alive[who] = new;
        if (any) walk_cells(value ? ahigh[e] : alow[e], target, labels, alive);
        alive[who] = old; release(mark);
    }
}
static void check_guards(int count, const long *source, const long *target, const long *sets, int start,
    const Labels *labels) {
    char **alive = room((size_t)agent_count, sizeof *alive);
    for (int g = 0; g < count; g++) {
        int some = 1;
        for (int h = 0; h < g; h++) {
            int apart = source && source[g] != source[h];
            for (int i = 0; i < agent_count && !apart; i++) {
                const Array *a = start ? grids[i].start_sets : grids[i].sets;
                const unsigned char *x = a->data + sets[g * agent_count + i] * grids[i].cells,
                    *y = a->data + sets[h * agent_count + i] * grids[i].cells;
                long s = 0;
                while (s < grids[i].cells && !(x[s] && y[s])) s++;
                apart = s == grids[i].cells;
            }
            no(!apart, "two guards are not disjoint");
        }
        for (int i = 0; i < agent_count; i++) {
            const Array *a = start ? grids[i].start_sets : grids[i].sets;
            const unsigned char *x = a->data + sets[g * agent_count + i] * grids[i].cells; int any = 0;
            alive[i] = room((size_t)labels[i].count, 1);
            for (long s = 0; s < grids[i].cells; s++)
                if (x[s]) alive[i][labels[i].class[s]] = 1, any = 1;
            some &= any;
        }
        if (some) walk_cells(aroot[source ? source[g] : initial], (int)target[g], labels, alive);
    }
}

/* Sums of n products of numbers from 0 on, from below. */
static double from_below(double sum, long n) { return sum <= 0 ? 0
    : most(0, sum * (1 - (double)(n + 4) * 0x1p-52) - (double)n * 1e-320); }

/* A factor one step back: the least expectations in cells that a policy aims from. */
static void step_back(const Agent *a, const Grid *g, const double *factor, const long *policy, double *out) {
    size_t mark = block_count; long count = g->cells; double *now = doubles((size_t)count);
    memcpy(now, factor, (size_t)count * sizeof *now);
    for (int k = a->d - 1; k >= 0; k--) { /* axis k: from cells to lattice points */
        long inner = 1, outer = 1, n = g->sizes[k], Z = g->lattice_sizes[k];
        for (int j = 0; j < k; j++) outer *= g->sizes[j];
        for (int j = k + 1; j < a->d; j++) inner *= g->lattice_sizes[j];
        double *next = doubles((size_t)(outer * inner * Z));
        for (long o = 0; o < outer; o++)
            for (long z = 0; z < Z; z++) {
                if (!g->aimed[k][z]) continue;
                double *to = next + (o * Z + z) * inner;
                const double *mass = g->mass[k] + z * n, *from = now + o * n * inner; long s = 0, end = n;
                while (end > 0 && mass[end - 1] == 0) end--;
                while (s < end && mass[s] == 0) s++;
                if (inner == 1) {
                    double sums[4] = {0, 0, 0, 0};
                    for (; s + 4 <= end; s += 4) for (int j = 0; j < 4; j++) sums[j] += mass[s + j] * from[s + j];
                    for (; s < end; s++) sums[0] += mass[s] * from[s];
                    to[0] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
                } else
                    for (; s < end; s++) for (long w = 0; w < inner; w++) to[w] += mass[s] * from[s * inner + w];
                for (long w = 0; w < inner; w++) to[w] = from_below(to[w], n);
            }
        now = next;
    }
    for (long s = 0; s < count; s++) out[s] = policy[s] < 0 ? 0 : now[policy[s]];
    release(mark);
}

static I rows_times(const double *m, const I *v, int n) {
    I sum = ZERO;
    for (int k = 0; k < n; k++) add_product(&sum, point(m[k]), v[k]);
    return sum;
}

static void read_grid(const Json *e, int who, Labels *labels) {
    const Agent *a = &agents[who]; Grid *g = &grids[who]; int d = a->d, m = a->m, k, j;
    has_keys(e, "an agent of `proof`", "edges lattice values parts inputs inverse sets start_sets policy");
    g->sizes = room((size_t)d, sizeof(long)), g->lattice_sizes = room((size_t)d, sizeof(long));
    g->edges = room((size_t)d, sizeof(double *)), g->lattice = room((size_t)d, sizeof(double *));
    g->cells = g->points = 1;
    for (int side = 0; side < 2; side++) {
        const Json *one = get_list(e, side ? "lattice" : "edges", d)->first;
        for (k = 0; k < d; k++, one = one->next) {
            const Array *axis = array_of(one, side ? "lattice" : "edges", 'f', 1, -1, 0, 0);
            double *x = reals_of(axis, "edges or lattice", 0); long n = axis->shape[0];
            no(n < (side ? 1 : 2), "an axis has no cells or points");
            for (long s = 1; s < n; s++) no(!(x[s - 1] < x[s]), "an axis does not increase");
            no(!side && (x[0] != a->state_low[k] || x[n - 1] != a->state_high[k]),
                "cells do not end with the workspace");
            if (side) g->lattice[k] = x, g->lattice_sizes[k] = n, g->points *= n;
            else g->edges[k] = x, g->sizes[k] = n - 1, g->cells *= n - 1;
            no(g->points > 1 << 28 || g->cells > 1 << 28, "there are too many cells or points for this checker");
        }
    }
    const char *values = text_of(get(e, "values"), "values");
    bad(strcmp(values, "cells") && strcmp(values, "corners"), "header: unknown `values`");
    whole_of(get(e, "parts"), "parts", 1, 1000000);
    if (array_of(get(e, "inputs"), "inputs", 'f', 2, -1, m, 0)->shape[0]) stop(NOT_COVERED,
        "cells with inputs that are chosen");
    g->sets = array_of(get(e, "sets"), "sets", 'b', 2, -1, g->cells, 0);
    g->start_sets = array_of(get(e, "start_sets"), "start_sets", 'b', 2, -1, g->cells, 0);
    const Array *policy = array_of(get(e, "policy"), "policy", 'i', 3, -1, Q, g->cells);
    g->policies = policy->shape[0]; bad(g->policies != 1 && g->policies != T, "array: `policy` has another shape");
    g->policy = wholes_of(policy, "policy", -1, g->points - 1);
    if (get(e, "inverse")->kind != NOTHING) g->inverse = reals_of(array_of(get(e, "inverse"), "inverse", 'f', 2, m, d,
        0), "inverse", 0);

    I *box = room((size_t)d, sizeof(I)), *v = room((size_t)d, sizeof(I)), *PA = room((size_t)(m * d), sizeof(I));
    I *off = room((size_t)(d * d), sizeof(I)); double *deviation = doubles((size_t)d), *missed = doubles((size_t)d);
    char *closed = room((size_t)d, 1), *label = room((size_t)region_count, 1);
    labels->class = room((size_t)g->cells, sizeof(int)); labels->labels = room(2000, (size_t)region_count);
    g->aimed = room((size_t)d, sizeof(char *)), g->mass = room((size_t)d, sizeof(double *));
    g->spread = doubles((size_t)d), g->missed = doubles((size_t)d);
    for (k = 0; k < d; k++) {
        g->aimed[k] = room((size_t)g->lattice_sizes[k], 1); int found = 0;
        for (j = 0; j < a->k; j++) {
            if (is_zero(a->N[k * a->k + j])) continue;
            found++;
            for (int i = 0; i < d; i++) if (i != k && !is_zero(a->N[i * a->k + j])) found = 2;
        }
        if (found != 1) stop(REFUSED, "the noise of `%s` is not one number for each state", a->name);
    }
    for (long s = 0; s < g->cells; s++) {
        for (long k1 = d - 1, rest = s; k1 >= 0; rest /= g->sizes[k1], k1--) {
            long n = rest % g->sizes[k1];
            box[k1] = (I){g->edges[k1][n], g->edges[k1][n + 1]}, closed[k1] = n == g->sizes[k1] - 1;
        }
        label_of(who, box, closed, label); classify(labels, s, label);
    }
    int aims = 0;
    for (long s = 0; s < g->policies * Q * g->cells; s++) aims |= g->policy[s] >= 0;
    if (!aims) return;
    if (!a->A) stop(NOT_COVERED, "targets of an agent whose dynamics are expressions");
    no(!g->inverse, "targets have no inverse");
    for (j = 0; j < m; j++)
        for (k = 0; k < d; k++)
            for (int i = 0; i < d; i++) add_product(&PA[j * d + k], point(g->inverse[j * d + i]),
                point(a->A[i * d + k]));
    for (k = 0; k < d; k++)
        for (j = 0; j < d; j++) {
            if (k == j) off[k * d + j] = point(-1);
            for (int i = 0; i < m; i++) add_product(&off[k * d + j], point(a->B[k * m + i]),
                point(g->inverse[i * d + j]));
        }
    for (k = 0; k < d * d; k++) no(!(mag(off[k]) <= 1e-6), "the inverse of the inputs is not next to one");
    /* targets: inputs in their boxes for all of the cell, and what means are off by */
    for (long n = 0; n < g->policies * Q * g->cells; n++) {
        long z = g->policy[n], s = n % g->cells, q = n / g->cells, earlier = 0;
        if (z < 0) continue;
        for (long p = q - 1; p >= 0 && p >= q - 8 && !earlier; p--) earlier = g->policy[p * g->cells + s] == z;
        if (earlier) continue;
        for (long k1 = d - 1, rest = s, aim = z; k1 >= 0; rest /= g->sizes[k1], aim /= g->lattice_sizes[k1], k1--) {
            long c = rest % g->sizes[k1], l = aim % g->lattice_sizes[k1];
            box[k1] = (I){g->edges[k1][c], g->edges[k1][c + 1]}, v[k1] = point(g->lattice[k1][l]), g->aimed[k1][l] = 1;
        }
        I size[64]; no(d > 64, "there are too many states for this checker");
        for (k = 0; k < d; k++) {
            I middle = sub(v[k], point(a->c[k])); /* z - c */
            size[k] = sub(middle, rows_times(a->A + k * d, box, d)); v[k] = middle;
        }
        for (j = 0; j < m; j++) {
            I u = rows_times(g->inverse + j * d, v, d); double large = 0;
            for (k = 0; k < d; k++) {
                add_product(&u, neg(PA[j * d + k]), box[k]); double part = mag(v[k]) + fabs(a->c[k]) * 2;
                for (int i = 0; i < d; i++) part += fabs(a->A[k * d + i]) * mag(box[i]);
                large += fabs(g->inverse[j * d + k]) * part;
            }
            no(u.lo < a->input_low[j] || u.hi > a->input_high[j], "an input of a target is outside its box");
            for (k = 0; k < d; k++) /* the input is computed with rounding */
                missed[k] = most(missed[k], m * fabs(a->B[k * m + j]) * large * 8 * (d + 4) * 0x1p-53);
        }
        for (k = 0; k < d; k++) {
            I miss = ZERO;
            for (j = 0; j < d; j++) add_product(&miss, off[k * d + j], size[j]);
            deviation[k] = most(deviation[k], mag(miss));
        }
    }
    double nine = tail_at(9).hi; /* masses farther away count as nothing */
    for (k = 0; k < d; k++) {
        I sigma = ZERO;
        for (j = 0; j < a->k; j++) if (!is_zero(a->N[k * a->k + j])) sigma = absolute(a->N[k * a->k + j]);
        double off_by = up(deviation[k] + missed[k]); long n = g->sizes[k], Z = g->lattice_sizes[k];
        g->spread[k] = sigma.hi, g->missed[k] = off_by;
        const Grid *like = NULL; /* an agent whose masses are the same */
        int axis = 0;
        for (int i = 0; i < who && !like; i++)
            for (axis = 0; axis < agents[i].d; axis++) {
                const Grid *o = &grids[i];
                if (o->mass[axis] && o->sizes[axis] == n && o->lattice_sizes[axis] == Z &&
                    o->spread[axis] == sigma.hi &&
                    o->missed[axis] == off_by && !memcmp(o->aimed[axis], g->aimed[k], (size_t)Z) &&
                    !memcmp(o->edges[axis], g->edges[k], (size_t)(n + 1) * 8) &&
                        !memcmp(o->lattice[axis], g->lattice[k], (size_t)Z * 8)) {
                    like = o; break;
                }
            }
        if (like) { g->mass[k] = like->mass[axis]; continue; }
        g->mass[k] = doubles((size_t)(n * Z));
        for (long z = 0; z < Z; z++) {
            if (!g->aimed[k][z]) continue;
            for (int side = 0; side < 2; side++) { /* the mass of an interval is least at an end of the means */
                double mean = side ? up(g->lattice[k][z] + off_by) : dn(g->lattice[k][z] - off_by);
                I low = ZERO, high = ZERO; /* upper tails of both edges, of the lower side where that is smaller */
                double x0 = 0, x1 = 0;
                for (long c = 0; c <= n; c++) {
                    I x = divide(sub(point(g->edges[k][c]), point(mean)), sigma); int left = x.hi <= 0;
                    if (fabs(x.lo) > 9 && fabs(x.hi) > 9) high = (I){0, nine};
                    else high = left ? (I){tail_at(-x.lo).lo, tail_at(-x.hi).hi}
                        : (I){tail_at(x.hi).lo, tail_at(x.lo).hi};
                    x1 = left ? -1 : 1;
                    if (c) {
                        double mass = x0 < 0 && x1 < 0 ? dn(high.lo - low.hi) : x0 > 0 ? dn(low.lo - high.hi)
                            : dn(dn(1 - low.hi) - high.hi);
                        double *to = &g->mass[k][z * n + c - 1];
                        *to = side ? least(*to, most(0, mass)) : most(0, mass);
                    }
                    low = high, x0 = x1;
                }
            }
        }
    }
}

typedef struct { int count; double **factor; } Values; /* of one automaton state: factor[vertex agents + agent] */

static double check_cells(const Json *proof) {
    const Json *part, *e; int i, q, G, G0; has_keys(proof, "`proof`", "kind guards start tree agents");
    no(pair_count, "cells are for tasks without pairs");
    for (i = 0; i < region_count; i++)
        no(regions[i].moves_low || regions[i].moves_high, "cells are for regions that stay");
    for (i = 0; i < agent_count; i++)
        no(agents[i].M || agents[i].others || agents[i].timed,
            "cells are for agents without neighbours, shared noise, and time");
    grids = room((size_t)agent_count, sizeof *grids);
    Labels *labels = room((size_t)agent_count, sizeof *labels), *at_start = room((size_t)agent_count, sizeof *at_start);
    const Json *list = get_list(proof, "agents", agent_count);
    for (e = list->first, i = 0; e; e = e->next, i++) read_grid(e, i, &labels[i]);
    has_keys(part = get(proof, "guards"), "`guards`", "source target sets");
    const Array *a = array_of(get(part, "source"), "source", 'i', 1, -1, 0, 0); G = (int)a->shape[0];
    long *source = wholes_of(a, "source", 0, Q - 1);
    long *target = wholes_of(array_of(get(part, "target"), "target", 'i', 1, G, 0, 0), "target", 0, Q - 1);
    long *sets = wholes_of(array_of(get(part, "sets"), "sets", 'i', 2, G, agent_count, 0), "sets", 0, LONG_MAX);
    has_keys(part = get(proof, "start"), "`start`", "target sets");
    a = array_of(get(part, "target"), "target", 'i', 1, -1, 0, 0); G0 = (int)a->shape[0];
    long *start_target = wholes_of(a, "target", 0, Q - 1);
    long *start_sets = wholes_of(array_of(get(part, "sets"), "sets", 'i', 2, G0, agent_count, 0), "sets", 0, LONG_MAX);
    has_keys(part = get(proof, "tree"), "`tree`", "vertices unions kept"); const Array *tables[3];
    long *table[3], at[3], widths[3] = {4, 6, 3};
    for (int k = 0; k < 3; k++) {
        static const char *names[3] = {"vertices", "unions", "kept"};
        tables[k] = array_of(get(part, names[k]), names[k], 'i', 2, -1, widths[k], 0);
        table[k] = wholes_of(tables[k], names[k], k == 1 ? -1000000000 : 0, 1000000000); at[k] = tables[k]->shape[0];
        for (long r = 0; r < at[k]; r++) {
            const long *x = table[k] + r * widths[k], *before = x - widths[k];
            if (x[0] < 0 || x[0] >= T || x[1] < 0 || x[1] >= Q) stop(REFUSED,
                "a row of `%s` has another time or state", names[k]);
            if (r && (before[0] > x[0] || (before[0] == x[0] && before[1] > x[1]))) stop(REFUSED,
                "`%s` is not in order", names[k]);
            if (cosafe && accepting[x[1]]) stop(REFUSED, "`%s` has rows of a state that accepts", names[k]);
        }
    }
    for (i = 0; i < array_count; i++) if (!arrays[i].named) stop(UNREADABLE, "array %d has no name", i);
    for (i = 0; i < agent_count; i++) {
        for (int g = 0; g < G; g++)
            no(sets[g * agent_count + i] >= grids[i].sets->shape[0], "a guard has a set that is not there");
        for (int g = 0; g < G0; g++)
            no(start_sets[g * agent_count + i] >= grids[i].start_sets->shape[0], "a guard has a set that is not there");
    }
    check_guards(G, source, target, sets, 0, labels);
    /* the start: shares of cells, from below, and labels of what the start has in them */
    double **share = room((size_t)agent_count, sizeof *share);
    for (i = 0; i < agent_count; i++) {
        const Agent *agent = &agents[i]; Grid *g = &grids[i]; I *box = room((size_t)agent->d, sizeof(I));
        char *closed = room((size_t)agent->d, 1), *label = room((size_t)region_count, 1);
        share[i] = doubles((size_t)g->cells);
        at_start[i].class = room((size_t)g->cells, sizeof(int)), at_start[i].labels = room(2000, (size_t)region_count);
        for (long s = 0; s < g->cells; s++) {
            I part_of = ONE;
            for (long k = agent->d - 1, rest = s; k >= 0; rest /= g->sizes[k], k--) {
                long n = rest % g->sizes[k];
                double x0 = g->edges[k][n], x1 = g->edges[k][n + 1], s0 = agent->start_low[k],
                    s1 = agent->start_high[k];
                box[k] = (I){most(x0, s0), least(x1, s1)}; closed[k] = s1 < x1 || n == g->sizes[k] - 1;
                int meets = s0 == s1 ? x0 <= s0 && (s0 < x1 || n == g->sizes[k] - 1) : box[k].lo < box[k].hi;
                if (!meets) part_of = ZERO;
                else if (s0 < s1) part_of = mul(part_of, divide(sub(point(box[k].hi), point(box[k].lo)),
                    sub(point(s1), point(s0))));
                if (s0 == s1) closed[k] = 1;
            }
            for (long k = agent->d - 1, rest = s; k >= 0 && is_zero(part_of); rest /= g->sizes[k], k--) {
                long n = rest % g->sizes[k]; /* no start is in this cell: its guard is asked for all of it */
                box[k] = (I){g->edges[k][n], g->edges[k][n + 1]}; closed[k] = n == g->sizes[k] - 1;
            }
            share[i][s] = least(1, most(0, part_of.lo)); label_of(i, box, closed, label);
            classify(&at_start[i], s, label);
        }
    }
    check_guards(G0, NULL, start_target, start_sets, 1, at_start);

    Values *later = room((size_t)Q, sizeof *later), *now = room((size_t)Q, sizeof *now); size_t base = block_count;
    for (long t = T; t >= 0; t--) {
        for (q = 0; q < Q; q++) {
            Values *v = &now[q]; v->count = 0, v->factor = NULL;
            if (accepting[q] && (t == T || cosafe)) {
                v->count = 1, v->factor = calloc((size_t)agent_count, sizeof(double *));
                for (i = 0; i < agent_count; i++) {
                    v->factor[i] = calloc((size_t)grids[i].cells, sizeof(double));
                    no(!v->factor[i], "memory is short");
                    for (long s = 0; s < grids[i].cells; s++) v->factor[i][s] = 1;
                }
                continue;
            }
            if (t == T) continue;
            long end[3], count[3];
            for (int k = 0; k < 3; k++) end[k] = at[k]; /* rows of (t, q) are found from the first one on */
            for (int k = 0; k < 3; k++) {
                long low = 0, high = tables[k]->shape[0], first;
                for (int upper = 0; upper < 2; upper++) {
                    low = 0, high = tables[k]->shape[0];
                    while (low < high) {
                        long middle = (low + high) / 2; const long *x = table[k] + middle * widths[k];
                        int before = x[0] < t || (x[0] == t && (x[1] < q || (upper && x[1] == q)));
                        if (before) low = middle + 1;
                        else high = middle;
                    }
                    if (!upper) first = end[k] = low;
                    else count[k] = low - first;
                }
            }
            size_t mark = block_count; double **factor = room((size_t)(count[0] * agent_count), sizeof *factor);
            char *gone = room((size_t)count[0], 1); Map seen = {0};
            for (long r = 0; r < count[0]; r++) {
                const long *x = table[0] + (end[0] + r) * 4; int new;
                no(x[2] >= G || source[x[2]] != q || x[3] >= later[target[x[2]]].count,
                    "a vertex has a wrong guard or child");
                map_at(&seen, two((int)x[2], (int)x[3]), 1, &new); no(!new, "two vertices have one guard and child");
                for (i = 0; i < agent_count; i++) {
                    double *f = factor[r * agent_count + i] = doubles((size_t)grids[i].cells),
                        *child = later[target[x[2]]].factor[x[3] * agent_count + i];
                    const unsigned char *in = grids[i].sets->data + sets[x[2] * agent_count + i] * grids[i].cells;
                    for (long s = 0; s < grids[i].cells; s++) f[s] = in[s] ? child[s] : 0;
                }
            }
            free(seen.entries);
            for (long r = 0; r < count[1]; r++) {
                const long *x = table[1] + (end[1] + r) * 6;
                long into = x[2], absorbed = x[3], who = x[4], rest = x[5] < 0 ? -x[5] - 1 : x[5] - 1;
                no(into < 0 || absorbed < 0 || into >= count[0] || absorbed >= count[0] || into == absorbed ||
                    gone[into] || gone[absorbed], "a union has a wrong vertex");
                no(who < 0 || who >= agent_count || (x[5] && (rest >= agent_count || rest == who)),
                    "a union has a wrong agent");
                for (i = 0; i < agent_count; i++)
                    for (long s = 0; s < grids[i].cells; s++) {
                        double *b0 = &factor[into * agent_count + i][s], *b1 = &factor[absorbed * agent_count + i][s],
                            b = *b0, c = *b1, m = least(b, c);
                        *b0 = i == who ? (b == 0 ? c : c == 0 ? b : dn(b + c)) : m;
                        if (!x[5]) continue;
                        double of = x[5] > 0 ? b : c;
                        *b1 = i == who ? of : i == rest ? (m == 0 ? of : most(0, of == m ? 0 : dn(of - m))) : m;
                    }
                if (!x[5]) gone[absorbed] = 1;
            }
            v->count = (int)count[2]; v->factor = calloc((size_t)(count[2] * agent_count) + 1, sizeof(double *));
            no(!v->factor, "memory is short");
            for (long r = 0; r < count[2]; r++) {
                long k = table[2][(end[2] + r) * 3 + 2];
                no(k >= count[0] || gone[k], "a vertex that is kept is not there, or kept twice"); gone[k] = 1;
                for (i = 0; i < agent_count; i++) {
                    double *out = v->factor[r * agent_count + i] = calloc((size_t)grids[i].cells, sizeof(double));
                    no(!out, "memory is short"); long when = grids[i].policies == 1 ? 0 : t;
                    step_back(&agents[i], &grids[i], factor[k * agent_count + i],
                        grids[i].policy + (when * Q + q) * grids[i].cells, out);
                }
            }
            release(mark);
        }
        for (q = 0; q < Q; q++) {
            for (long k = 0; k < (long)later[q].count * agent_count; k++) free(later[q].factor[k]);
            free(later[q].factor); later[q] = now[q];
        }
    }
    release(base); double value = 0;
    for (int g = 0; g < G0; g++)
        for (int v = 0; v < later[start_target[g]].count; v++) {
            double product = 1;
            for (i = 0; i < agent_count && product > 0; i++) {
                const unsigned char *in = grids[i].start_sets->data + start_sets[g * agent_count + i] * grids[i].cells;
                double sum = 0;
                for (long s = 0; s < grids[i].cells; s++)
                    if (in[s] && share[i][s] > 0) sum += share[i][s] * later[start_target[g]].factor[v * agent_count + i][s];
                product = most(0, dn(product * from_below(sum, grids[i].cells)));
            }
            value = value == 0 ? product : product == 0 ? value : dn(value + product);
        }
    for (q = 0; q < Q; q++) {
        for (long k = 0; k < (long)later[q].count * agent_count; k++) free(later[q].factor[k]);
        free(later[q].factor);
    }
    return most(0, up(1 - value));
}

int main(int count, char **words) {
    if (count != 2) return printf("one file, please: checker FILE\n"), UNREADABLE;
    FILE *file = fopen(words[1], "rb");
    if (!file) stop(UNREADABLE, "there is no file %s", words[1]);
    List bytes = {0}; unsigned char buffer[65536];
    for (size_t n; (n = fread(buffer, 1, sizeof buffer, file)) > 0;) {
        while (bytes.room < bytes.count + n) {
            bytes.room = bytes.room ? 2 * bytes.room : sizeof buffer;
            bad(!(bytes.data = realloc(bytes.data, bytes.room)), "memory is short");
        }
        memcpy((unsigned char *)bytes.data + bytes.count, buffer, n); bytes.count += n;
    }
    fclose(file); raw = bytes.data, raw_size = bytes.count; set_constants(); read_archive(&json_place, &bytes.room);
    json_end = json_place + bytes.room; check_utf8((const unsigned char *)json_place, bytes.room);
    Json *header = json_value(0); json_blanks(); bad(json_place != json_end, "header: something follows the JSON");
    has_keys(header, "the header", "format version name problem claim proof notes?");
    bad(strcmp(text_of(get(header, "format"), "format"), "certigym-certificate"), "header: another format");
    whole_of(get(header, "version"), "version", 3, 3); text_of(get(header, "name"), "name");
    has_keys(get(header, "claim"), "`claim`", "failure");
    double claim = number_of(get(get(header, "claim"), "failure"), "failure"), failure;
    bad(!(claim >= 0 && claim <= 1), "header: the claim is no probability"); read_problem(get(header, "problem"));
    const Json *proof = get(header, "proof"), *kind;
    bad(proof->kind != TABLE || !(kind = get(proof, "kind")), "header: `proof` has no kind"); text_of(kind, "kind");
    if (not_covered) stop(NOT_COVERED, "noise that is not normal, or of a size that varies");
    if (!strcmp(kind->text, "trajectory")) check_trajectory(proof), failure = failure_of_rows();
    else if (!strcmp(kind->text, "cells")) failure = check_cells(proof);
    else stop(UNREADABLE, "header: a kind of proof that is unknown");
    if (formula_text) check_formula();
    if (!(failure <= claim)) stop(REFUSED, "failure <= %.17g is above the claim of %.17g", failure, claim);
    stop(PROVED, "failure <= %.17g (claimed %.17g)%s", failure, claim, formula_text ? ""
        : "; the automaton is the task");
}
