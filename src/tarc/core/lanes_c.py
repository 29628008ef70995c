"""C text for lanes: one vector type, its masks, and elementary functions that agree bit for bit at every width.

With ``LANES`` at 1 the types are plain C. Beyond, they are vectors of GCC and Clang with one run in each lane. All
functions are written once over the same macros. They use no fused products, so that a lane has the bits of plain C.

Errors are in units in the last place (ulp), measured against mpmath by ``tests/core/test_lanes.py``.
"""

TYPES = """
#include <math.h>
#include <stdbool.h>
#include <string.h>

#if LANES > 1
typedef double REAL __attribute__((vector_size(8 * LANES)));
typedef long long TRUTH __attribute__((vector_size(8 * LANES)));
typedef unsigned long long BITS __attribute__((vector_size(8 * LANES)));
#define ALL(x) ((x) - (REAL){0})
#define LESS(a, b) ((TRUTH)((a) < (b)))
#define AT_MOST(a, b) ((TRUTH)((a) <= (b)))
#define EQUAL(a, b) ((TRUTH)((a) == (b)))
#define DIFFERENT(a, b) ((TRUTH)((a) != (b)))
#define AND(a, b) ((a) & (b))
#define OR(a, b) ((a) | (b))
#define NOT(a) (~(a))
#define PICK(m, a, b) ((REAL)(((m) & (TRUTH)(a)) | (~(m) & (TRUTH)(b))))
#define PICK_OR_ZERO(m, a) ((REAL)((m) & (TRUTH)(a)))
#define TO_BITS(x) ((BITS)(x))
#define FROM_BITS(b) ((REAL)(b))
static inline bool some(TRUTH m)
{
  long long any = 0;
  for (int i = 0; i < LANES; ++i)
    any |= m[i];
  return any != 0;
}
#define RARE(m, r, function, x) \\
  if (some(m)) \\
    for (int i = 0; i < LANES; ++i) \\
      if ((m)[i]) \\
        (r)[i] = function((x)[i]);
#define EACH_LANE(function) \\
  static inline REAL each_##function(REAL x) \\
  { \\
    REAL r; \\
    for (int i = 0; i < LANES; ++i) \\
      r[i] = function(x[i]); \\
    return r; \\
  }
#define EACH_LANE_OF_TWO(function) \\
  static inline REAL each_##function(REAL x, REAL y) \\
  { \\
    REAL r; \\
    for (int i = 0; i < LANES; ++i) \\
      r[i] = function(x[i], y[i]); \\
    return r; \\
  }
#else
typedef double REAL;
typedef bool TRUTH;
typedef unsigned long long BITS;
#define ALL(x) (x)
#define LESS(a, b) ((a) < (b))
#define AT_MOST(a, b) ((a) <= (b))
#define EQUAL(a, b) ((a) == (b))
#define DIFFERENT(a, b) ((a) != (b))
#define AND(a, b) ((a) && (b))
#define OR(a, b) ((a) || (b))
#define NOT(a) (!(a))
#define PICK(m, a, b) ((m) ? (a) : (b))
#define PICK_OR_ZERO(m, a) ((m) ? (a) : 0.0)
static inline BITS TO_BITS(double x)
{
  BITS b;
  memcpy(&b, &x, sizeof b);
  return b;
}
static inline double FROM_BITS(BITS b)
{
  double x;
  memcpy(&x, &b, sizeof x);
  return x;
}
static inline bool some(TRUTH m)
{
  return m;
}
#define RARE(m, r, function, x) \\
  if (m) \\
    (r) = function(x);
#define EACH_LANE(function) \\
  static inline REAL each_##function(REAL x) \\
  { \\
    return function(x); \\
  }
#define EACH_LANE_OF_TWO(function) \\
  static inline REAL each_##function(REAL x, REAL y) \\
  { \\
    return function(x, y); \\
  }
#endif
#define SIGN_BIT 0x8000000000000000ULL
#define MAGNITUDE(x) FROM_BITS(TO_BITS(x) & ~SIGN_BIT)
#define WITH_SIGN(x, y) FROM_BITS((TO_BITS(x) & ~SIGN_BIT) | (TO_BITS(y) & SIGN_BIT))
#define ONE_IF(m) PICK_OR_ZERO(m, ALL(1.0))
EACH_LANE(sqrt)
EACH_LANE(floor)
EACH_LANE(ceil)
EACH_LANE(tan)
EACH_LANE(asin)
EACH_LANE(acos)
EACH_LANE(atan)
EACH_LANE(sinh)
EACH_LANE(cosh)
EACH_LANE_OF_TWO(pow)
EACH_LANE_OF_TWO(atan2)
EACH_LANE_OF_TWO(fmod)
EACH_LANE_OF_TWO(hypot)
"""
"""Types and operations; functions that are rare are called lane by lane from the C library."""

FUNCTIONS = """
/* Adding this and taking it away again rounds to a whole number, whose last bits are those of the sum. */
#define ROUNDER 6755399441055744.0

/* sin and cos: x = k pi/2 + r with three parts of pi/2 after Cody and Waite, then the polynomials of fdlibm. */
#define WIDEST_ANGLE 1e5

static inline REAL sine_of_rest(REAL r, REAL tail)
{
  const REAL z = r * r;
  const REAL v = z * r;
  const REAL p = (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)) +
                 z * z * z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
  return r - ((z * (0.5 * tail - v * p) - tail) - v * -1.66666666666666324348e-01);
}

static inline REAL cosine_of_rest(REAL r, REAL tail)
{
  const REAL z = r * r;
  const REAL w = z * z;
  const REAL c = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05)) +
                 w * w * (-2.75573143513906633035e-07 +
                          z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
  const REAL half = 0.5 * z;
  const REAL rest = 1.0 - half;
  return rest + (((1.0 - rest) - half) + (z * c - r * tail));
}

static inline REAL sine_of(REAL x, unsigned quarter)
{
  const REAL t = x * 6.36619772367581382433e-01 + ROUNDER;
  const REAL k = t - ROUNDER;
  const BITS turn = TO_BITS(t) + quarter;
  const REAL a = x - k * 1.57079632673412561417e+00;
  const REAL b = k * 6.07710050630396597660e-11;
  const REAL r = a - b;
  const REAL tail = ((a - r) - b) - k * 2.02226624879595063154e-21;
#if LANES > 1
  const REAL chosen = PICK(DIFFERENT(turn & 1, 0), cosine_of_rest(r, tail), sine_of_rest(r, tail));
#else
  const REAL chosen = turn & 1 ? cosine_of_rest(r, tail) : sine_of_rest(r, tail);
#endif
  return FROM_BITS(TO_BITS(chosen) ^ ((turn & 2) << 62));
}

static inline REAL own_sin(REAL x)
{
  REAL r = sine_of(x, 0);
  RARE(NOT(AT_MOST(MAGNITUDE(x), WIDEST_ANGLE)), r, sin, x)
  return r;
}

static inline REAL own_cos(REAL x)
{
  REAL r = sine_of(x, 1);
  RARE(NOT(AT_MOST(MAGNITUDE(x), WIDEST_ANGLE)), r, cos, x)
  return r;
}

/* exp: x = k ln 2 + r with two parts of ln 2, and the Taylor polynomial of degree 13 on |r| <= ln 2 / 2. */
static inline REAL exp_of_rest(REAL r, REAL lost)
{
  const REAL z = r * r;
  const REAL w = z * z;
  const REAL p = ((0.5 + r * 1.66666666666666666667e-01) +
                  z * (4.16666666666666666667e-02 + r * 8.33333333333333333333e-03)) +
                 w * ((1.38888888888888888889e-03 + r * 1.98412698412698412698e-04) +
                      z * (2.48015873015873015873e-05 + r * 2.75573192239858906526e-06)) +
                 w * w * ((2.75573192239858906526e-07 + r * 2.50521083854417187751e-08) +
                          z * (2.08767569878680989792e-09 + r * 1.60590438368216145994e-10));
  return 1.0 + (r + (z * p - lost));
}

static inline REAL own_exp(REAL x)
{
  const REAL inside = PICK(LESS(x, 710.0), PICK(LESS(-746.0, x), x, ALL(-746.0)), ALL(710.0));
  const REAL t = inside * 1.44269504088896338700e+00 + ROUNDER;
  const REAL k = t - ROUNDER;
  const REAL high = inside - k * 6.93147180369123816490e-01;
  const REAL low = k * 1.90821492927058770002e-10;
  const REAL r = high - low;
  const REAL lost = (r - high) + low;
  const REAL first = 0.5 * k + ROUNDER;
  const BITS half = TO_BITS(first) - TO_BITS(ALL(ROUNDER));
  const BITS other = (TO_BITS(t) - TO_BITS(ALL(ROUNDER))) - half;
  const REAL y = exp_of_rest(r, lost) * FROM_BITS((half + 1023) << 52) * FROM_BITS((other + 1023) << 52);
  return PICK(DIFFERENT(x, x), x, y);
}

/* tanh: the quotient of Cephes below 0.625, then 1 - 2 / (exp(2 |x|) + 1). */
static inline REAL own_tanh(REAL x)
{
  const REAL size = MAGNITUDE(x);
  const REAL twice = 2.0 * PICK(LESS(size, 22.0), size, ALL(22.0));
  const REAL t = twice * 1.44269504088896338700e+00 + ROUNDER;
  const REAL k = t - ROUNDER;
  const REAL high = twice - k * 6.93147180369123816490e-01;
  const REAL low = k * 1.90821492927058770002e-10;
  const REAL r = high - low;
  const REAL lost = (r - high) + low;
  const BITS power = TO_BITS(t) - TO_BITS(ALL(ROUNDER));
  const REAL e = exp_of_rest(r, lost) * FROM_BITS((power + 1023) << 52);
  const REAL z = size * size;
  const REAL p = z * (-1.61468768441708447952e+03 +
                      z * (-9.92877231001918586564e+01 + z * -9.64399179425052238628e-01));
  const REAL q = 4.84406305325125486048e+03 + z * (2.23548839060100448583e+03 + z * (1.12811678491632931402e+02 + z));
  const TRUTH is_small = LESS(size, 0.625);
  const REAL quotient = PICK(is_small, p, ALL(-2.0)) / PICK(is_small, q, e + 1.0);
  const REAL y = PICK(is_small, size + size * quotient, 1.0 + quotient);
  return PICK(DIFFERENT(x, x), x, WITH_SIGN(y, x));
}

/* log: x = 2^k m with m in [sqrt(1/2), sqrt(2)), then the polynomial of fdlibm. */
static inline REAL own_log(REAL x)
{
  const BITS moved = TO_BITS(x) + (0x3ff0000000000000ULL - 0x3fe6a09e667f3bcdULL);
  const REAL k = FROM_BITS((moved >> 52) - 1023 + TO_BITS(ALL(ROUNDER))) - ROUNDER;
  const REAL m = FROM_BITS((moved & 0x000fffffffffffffULL) + 0x3fe6a09e667f3bcdULL);
  const REAL f = m - 1.0;
  const REAL square = 0.5 * f * f;
  const REAL s = f / (2.0 + f);
  const REAL z = s * s;
  const REAL w = z * z;
  const REAL odd = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
  const REAL even = z * (6.666666666666735130e-01 +
                         w * (2.857142874366239149e-01 +
                              w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)));
  REAL r = k * 6.93147180369123816490e-01 -
           ((square - (s * (square + (odd + even)) + k * 1.90821492927058770002e-10)) - f);
  RARE(NOT(AND(AT_MOST(2.2250738585072014e-308, x), AT_MOST(x, 1.7976931348623157e308))), r, log, x)
  return r;
}
"""
"""sin, cos, exp, tanh and log. Arguments outside their ranges go to the C library, lane by lane."""
