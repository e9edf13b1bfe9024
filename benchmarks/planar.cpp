/* Populations of planar models, robots side by side in vectors: the limit beside which benchmarks/simulate.py shows numba's lanes.
 *
 * The arithmetic is that of ssmr/models, for motors with a proportional loop and a limit and drivers without lag, to the bit if
 * the compiler fuses nothing by itself (-ffp-contract=off). shared.h, which benchmarks/simulate.py writes, declares LANES, a vector V
 * of so many numbers, and structures drive_t, coulomb_t, ... of such vectors with the fields of the Python classes. */
#include <cmath>
#include <cstring>
#include <vector>

#include "shared.h"

typedef long Whole __attribute__((vector_size(sizeof(V))));
#define INLINE static inline __attribute__((always_inline))
#ifdef FP_FAST_FMA
#define FUSED(a, b, c) __builtin_fma(a, b, c)
#else
#define FUSED(a, b, c) ((a) * (b) + (c))
#endif

INLINE V clip(V x, V limit) {
  x = x < limit ? x : limit;
  return x > -limit ? x : -limit;
}
INLINE V size(V x) { return (V)((Whole)x & 0x7fffffffffffffffL); }
INLINE V with_sign(V amount, V x) { return (V)((Whole)amount | ((Whole)x & (1L << 63))); }
INLINE V opposing(V amount, V x) { return x != 0.0 ? with_sign(amount, x) : V{}; } /* amount sgn(x) */

INLINE V fused(V a, V b, V c) { /* a b + c, rounded once where the processor can */
  V sum;
  for (int i = 0; i < LANES; i++) sum[i] = FUSED(a[i], b[i], c[i]);
  return sum;
}

INLINE void sine_cosine(V angle, V &sine, V &cosine) { /* ssmr/_trig.py */
  static const double S[] = {-1.66666666666666307295e-1, 8.33333333332211858878e-3, -1.98412698295895385996e-4, 2.75573136213857245213e-6,
                             -2.50507477628578072866e-8, 1.58962301576546568060e-10},
                      C[] = {4.16666666666665929218e-2, -1.38888888888730564116e-3, 2.48015872888517045348e-5, -2.75573141792967388112e-7,
                             2.08757008419747316778e-9, -1.13585365213876817300e-11};
  V shifted = fused(angle, V{} + 0.6366197723675814, V{} + 6755399441055744.0), n = shifted - 6755399441055744.0;
  V r = fused(-n, V{} + 1.5707963267948966, angle), z = r * r, s = V{} + S[5], c = V{} + C[5];
  for (int k = 4; k >= 0; k--) s = fused(s, z, V{} + S[k]), c = fused(c, z, V{} + C[k]);
  s = fused(r * z, s, r), c = fused(z * z, c, fused(V{} - 0.5, z, V{} + 1.0));
  Whole quadrant = (Whole)shifted, odd = (quadrant & 1) != 0;
  sine = (V)((Whole)(odd ? c : s) ^ ((quadrant & 2) << 62));
  cosine = (V)((Whole)(odd ? s : c) ^ (((quadrant + 1) & 2) << 62));
}

template <class Robot> INLINE void torques(V v, V w, V wanted_left, V wanted_right, V gain, const Robot &u, V &left, V &right) {
  left = clip(gain * (wanted_left - (v - u.vehicle.effective_half_track * w) * u.vehicle.per_radius_left), u.motor.limit);
  right = clip(gain * (wanted_right - (v + u.vehicle.effective_half_track * w) * u.vehicle.per_radius_right), u.motor.limit);
}

template <class Robot> INLINE void thrust(V v, V w, V wanted_left, V wanted_right, const Robot &u, V &force, V &moment) {
  V left, right;
  torques(v, w, wanted_left, wanted_right, u.parameters.gain, u, left, right);
  left *= u.vehicle.per_radius_left, right *= u.vehicle.per_radius_right;
  force = left + right, moment = u.vehicle.half_track * (right - left);
}

INLINE void advance(V &v, V &w, V wanted_left, V wanted_right, double dt, const coulomb_t &u) {
  V c = u.vehicle.half_track, left = opposing(u.constants.rolling, v - c * w), right = opposing(u.constants.rolling, v + c * w);
  V resist = left + right, resist_yaw = opposing(u.constants.skidding, w) + c * (right - left), aside = u.constants.aside, force, moment;
  thrust(v, w, wanted_left, wanted_right, u, force, moment);
  V dv = (force - resist - aside * w * w) * u.vehicle.per_moved;
  V dw = (moment - resist_yaw + aside * w * v) * u.vehicle.per_turned_aside, v1 = v + dt * dv, w1 = w + dt * dw;
  thrust(v1, w1, wanted_left, wanted_right, u, force, moment);
  v += 0.5 * dt * (dv + (force - resist - aside * w1 * w1) * u.vehicle.per_moved);
  w += 0.5 * dt * (dw + (moment - resist_yaw + aside * w1 * v1) * u.vehicle.per_turned_aside);
}

INLINE V stop(V next, V v, Whole moving) { return moving & (((Whole)next ^ (Whole)v) < 0) ? V{} : next; }

INLINE void advance(V &v, V &w, V wanted_left, V wanted_right, double dt, const improved_t &u) {
  V force, moment, rolling = u.constants.rolling, sticking = u.constants.sticking;
  thrust(v, w, wanted_left, wanted_right, u, force, moment);
  Whole moving = v != 0.0, turning = w != 0.0, go = moving | (size(force) > rolling), spin = turning | (size(moment) > sticking);
  V f = moving ? with_sign(rolling, v) : clip(force, rolling), m = turning ? with_sign(u.constants.skidding, w) : clip(moment, sticking);
  V dv = (force - f) * u.vehicle.per_moved, dw = (moment - m) * u.vehicle.per_turned;
  thrust(v + dt * dv, w + dt * dw, wanted_left, wanted_right, u, force, moment);
  dv += go ? (force - f) * u.vehicle.per_moved : V{}, dw += spin ? (moment - m) * u.vehicle.per_turned : V{};
  v = stop(v + 0.5 * dt * dv, v, moving);
  w = stop(w + 0.5 * dt * dw, w, turning);
}

INLINE void advance(V &v, V &w, V wanted_left, V wanted_right, double, const linear_t &u) {
  V left, right;
  torques(v, w, wanted_left, wanted_right, u.constants.gain, u, left, right);
  Whole free = (size(left) < u.motor.limit) & (size(right) < u.motor.limit);
  V along_left = u.vehicle.radius_left * wanted_left, along_right = u.vehicle.radius_right * wanted_right;
  V dv = free ? u.constants.loop * (along_left + along_right) : u.constants.force * (left + right);
  V dw = free ? u.constants.loop_yaw * (along_right - along_left) : u.constants.moment * (right - left);
  v += (free ? u.constants.free_decay_v : u.constants.held_decay_v) * v + (free ? u.constants.free_push_v : u.constants.held_push_v) * dv;
  w += (free ? u.constants.free_decay_w : u.constants.held_decay_w) * w + (free ? u.constants.free_push_w : u.constants.held_push_w) * dw;
}

INLINE void advance(V &v, V &w, V wanted_left, V wanted_right, double, const kinematic_t &u) {
  V left = u.constants.rolled_left * wanted_left;
  w = (u.constants.rolled_right * wanted_right - left) * u.constants.per_width;
  v = left + w * u.parameters.y_l;
}

/* What all drivers hold of one column of (count, 2) commands, behind as many steps of zeros. */
static std::vector<double> held(const double *values, long count, long steps, const drive_t &d) {
  std::vector<double> out(2 * steps);
  long hold = d.hold[0], ramp = d.ramp[0], period = d.period[0];
  for (long k = 0; k < steps; k++) {
    long sample = k / hold, at = sample * hold / period, before = (sample - 1) * hold / period, since = k % hold + 1;
    double value = values[2 * (at < count ? at : count - 1)], last = sample ? values[2 * (before < count ? before : count - 1)] : 0.0;
    out[steps + k] = since < ramp ? last + (value - last) * ((double)since / ramp) : value;
  }
  return out;
}

template <class Robot> struct Group { /* LANES robots on their way */
  struct { drive_t drive; Robot robot; } u;
  V x, y, yaw, v, w, asked_v, asked_w;
  const double *held_v[LANES], *held_w[LANES];
};

template <class Robot> INLINE void step(Group<Robot> &g, long k, double dt) {
  const drive_t &d = g.u.drive;
  V told_v, told_w;
  for (int i = 0; i < LANES; i++) told_v[i] = g.held_v[i][k], told_w[i] = g.held_w[i][k];
  g.asked_v += clip(clip(told_v, d.v_max) - g.asked_v, d.change_v);
  g.asked_w += clip(clip(told_w, d.w_max) - g.asked_w, d.change_w);
  V left = (g.asked_v - d.half_track * g.asked_w) * d.per_radius, right = (g.asked_v + d.half_track * g.asked_w) * d.per_radius;
  V v = g.v, w = g.w, half = V{} + 0.5 * dt, s, c;
  advance(v, w, left, right, dt, g.u.robot);
  V v_twice = g.v + v, w_twice = g.w + w, aside = g.u.robot.x_icr * w_twice;
  g.v = v, g.w = w;
  sine_cosine(fused(0.5 * half, w_twice, g.yaw), s, c);
  g.x = fused(half, fused(v_twice, c, aside * s), g.x);
  g.y = fused(half, fused(v_twice, s, -aside * c), g.y);
  g.yaw = fused(half, w_twice, g.yaw);
}

/* Writes (robots, samples, 3) poses of robots that start at rest at the origin; LANES divides their number. `rows` holds the numbers of
 * each LANES robots, each number LANES times; `values` are (count, 2) commands. */
template <class Robot>
static void drive(long robots, const double *rows, const double *values, long count, long steps, double dt, long stride, double *poses) {
  const long samples = steps / stride + 1;
  std::vector<double> held_v, held_w;
  for (long first = 0; first < robots; first += LANES) {
    Group<Robot> g;
    memset(&g, 0, sizeof g);
    memcpy(&g.u, rows + first * (sizeof g.u / sizeof(V)), sizeof g.u);
    if (first == 0) held_v = held(values, count, steps, g.u.drive), held_w = held(values + 1, count, steps, g.u.drive);
    for (int i = 0; i < LANES; i++) {
      g.held_v[i] = held_v.data() + steps - (long)g.u.drive.delay_v[i];
      g.held_w[i] = held_w.data() + steps - (long)g.u.drive.delay_w[i];
    }
    double *out = poses + 3 * first * samples;
    for (long k = 0, due = 0; k <= steps; k++) {
      if (k == due) {
        for (int i = 0; i < LANES; i++) {
          double *pose = out + 3 * i * samples;
          pose[0] = g.x[i], pose[1] = g.y[i], pose[2] = g.yaw[i];
        }
        out += 3, due += stride;
      }
      if (k < steps) step(g, k, dt);
    }
  }
}

#define MODEL(name)                                                                                                             \
  extern "C" void name(long robots, const double *rows, const double *values, long count, long steps, double dt, long stride,  \
                       double *poses) {                                                                                         \
    drive<name##_t>(robots, rows, values, count, steps, dt, stride, poses);                                                     \
  }
MODEL(coulomb)
MODEL(improved)
MODEL(linear)
MODEL(kinematic)
