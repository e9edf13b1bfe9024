/* The planar models' loop in C, as one would write it by hand: the yardstick of benchmarks/simulate.py.
 *
 * The arithmetic is that of ssmr/models. Commands have become wheel-rate references before, and the same numbers of every step are written.
 * shared.h, which benchmarks/simulate.py writes, declares what both languages share: the models' numbers (COULOMB, ...), the structures
 * vehicle_t, coulomb_t, ... with the fields of the Python classes, the constant LOAD_SUM, and COLUMNS, the numbers of a step. */
#include <math.h>

#include "shared.h"

static double sign(double x) { return (x > 0.0) - (x < 0.0); }
static double clip(double x, double limit) { return fmin(fmax(x, -limit), limit); }

static void torques(double v, double w, const double *ref, const vehicle_t *u, double gain, double limit, double *left, double *right) {
  *left = clip(gain * (ref[0] - (v - u->effective_half_track * w) / u->wheel_radius), limit);
  *right = clip(gain * (ref[1] - (v + u->effective_half_track * w) / u->wheel_radius), limit);
}

static void coulomb_rates(double v, double w, const double *ref, const vehicle_t *u, const coulomb_t *p, double limit, const double *resist,
                          double *dv, double *dw) {
  double left, right;
  torques(v, w, ref, u, p->gain, limit, &left, &right);
  *dv = ((left + right) / u->wheel_radius - resist[0] - u->mass * u->x_icr * w * w) / u->mass;
  *dw = (u->half_track * (right - left) / u->wheel_radius - resist[1] + u->mass * u->x_icr * w * v) /
        (u->yaw_inertia + u->mass * u->x_icr * u->x_icr);
}

static void coulomb(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const coulomb_t *p, double limit, double *torque) {
  double front = u->mass * u->gravity * u->a / (2.0 * (u->a + u->b)), rear = u->mass * u->gravity * u->b / (2.0 * (u->a + u->b));
  double s_left = sign(*v - u->half_track * *w), s_right = sign(*v + u->half_track * *w);
  double f_front = 2.0 * p->mu_c * front * sign((u->b - u->x_icr) * *w), f_rear = 2.0 * p->mu_c * rear * sign((-u->a - u->x_icr) * *w);
  double left = p->u_x * (front + rear) * s_left, right = p->u_x * (front + rear) * s_right;
  double resist[2] = {left + right, u->b * f_front - u->a * f_rear + u->half_track * (right - left) - u->x_icr * (f_front + f_rear)};
  double dv, dw, dv2, dw2;
  coulomb_rates(*v, *w, ref, u, p, limit, resist, &dv, &dw);
  coulomb_rates(*v + dt * dv, *w + dt * dw, ref, u, p, limit, resist, &dv2, &dw2);
  torques(*v, *w, ref, u, p->gain, limit, torque, torque + 1);
  *v += 0.5 * dt * (dv + dv2);
  *w += 0.5 * dt * (dw + dw2);
}

static double dry(double active, double fs, double fd, double v) {
  if (v == 0.0) return fabs(active) <= fs ? -active : -sign(active) * fs;
  return -sign(v) * fd;
}

static void improved(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const improved_t *p, double limit, double *torque) {
  double left, right, load = u->mass * u->gravity, lever = load * 2.0 * u->a * u->b / (u->a + u->b);
  torques(*v, *w, ref, u, p->gain, limit, &left, &right);
  torque[0] = left, torque[1] = right;
  double force = (left + right) / u->wheel_radius, moment = u->half_track * (right - left) / u->wheel_radius;
  double f = dry(force, p->u_x * load, p->u_x * load, *v), m = dry(moment, p->mu_s * lever, p->mu_d * lever, *w);
  int stuck = *v == 0.0 && f == -force, stuck_yaw = *w == 0.0 && m == -moment;
  double dv = stuck ? 0.0 : (force + f) / u->mass, dw = stuck_yaw ? 0.0 : (moment + m) / u->yaw_inertia;
  torques(*v + dt * dv, *w + dt * dw, ref, u, p->gain, limit, &left, &right);
  double dv2 = stuck ? 0.0 : ((left + right) / u->wheel_radius + f) / u->mass;
  double dw2 = stuck_yaw ? 0.0 : (u->half_track * (right - left) / u->wheel_radius + m) / u->yaw_inertia;
  double v2 = *v + 0.5 * dt * (dv + dv2), w2 = *w + 0.5 * dt * (dw + dw2);
  *v = v2 * *v < 0.0 ? 0.0 : v2;
  *w = w2 * *w < 0.0 ? 0.0 : w2;
}

static void linear(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const linear_t *p, double limit, double *torque) {
  double loop = 2.0 * p->gain / (u->wheel_radius * u->mass), friction = LOAD_SUM * u->gravity * p->k_u;
  double loop_yaw = 2.0 * p->gain * u->half_track / (u->wheel_radius * u->yaw_inertia);
  double friction_yaw = u->mass * u->gravity * p->k_y * u->half_track / u->yaw_inertia;
  double vl = u->wheel_radius * ref[0], vr = u->wheel_radius * ref[1];
  double left = clip(p->gain * (vl - *v + u->effective_half_track * *w), limit);
  double right = clip(p->gain * (vr - *v - u->effective_half_track * *w), limit);
  torque[0] = left, torque[1] = right;
  double rate_v, drive_v, rate_w, drive_w;
  if (fabs(left) < limit && fabs(right) < limit) {
    rate_v = loop + friction, drive_v = loop * 0.5 * (vl + vr);
    rate_w = loop_yaw * u->effective_half_track + friction_yaw, drive_w = loop_yaw * 0.5 * (vr - vl);
  } else {
    rate_v = friction, drive_v = (left + right) / (u->wheel_radius * u->mass);
    rate_w = friction_yaw, drive_w = u->half_track * (right - left) / (u->wheel_radius * u->yaw_inertia);
  }
  *v += expm1(-rate_v * dt) * (*v - drive_v / rate_v);
  *w += expm1(-rate_w * dt) * (*w - drive_w / rate_w);
}

static void kinematic(double *v, double *w, const double *ref, const vehicle_t *u, const kinematic_t *p) {
  double left = p->alpha_l * u->wheel_radius * ref[0], right = p->alpha_r * u->wheel_radius * ref[1];
  *w = (right - left) / (p->y_l - p->y_r);
  *v = left + *w * p->y_l;
}

double simulate(int model, long n, const double *refs, double dt, const vehicle_t *u, const void *p, double limit, double *out) {
  double x = 0.0, y = 0.0, yaw = 0.0, v = 0.0, w = 0.0;
  double x_icr = model == COULOMB ? u->x_icr : model == KINEMATIC ? ((const kinematic_t *)p)->x_icr : 0.0;
  for (long k = 0; k < n; k++) {
    const double *ref = refs + 2 * k;
    double v0 = v, w0 = w, torque[2] = {0.0, 0.0};
    switch (model) {
      case COULOMB: coulomb(&v, &w, ref, dt, u, p, limit, torque); break;
      case IMPROVED: improved(&v, &w, ref, dt, u, p, limit, torque); break;
      case LINEAR: linear(&v, &w, ref, dt, u, p, limit, torque); break;
      case KINEMATIC: kinematic(&v, &w, ref, u, p); break;
      default: return NAN;
    }
    double vm = 0.5 * (v0 + v), wm = 0.5 * (w0 + w), heading = yaw + 0.5 * dt * wm, c = cos(heading), s = sin(heading);
    x += dt * (vm * c + x_icr * wm * s);
    y += dt * (vm * s - x_icr * wm * c);
    yaw += dt * wm;
    double turn = (w - w0) / dt;
    double *row = out + COLUMNS * k;
    row[0] = x, row[1] = y, row[2] = yaw, row[3] = v, row[4] = -x_icr * w, row[5] = w;
    row[6] = model == KINEMATIC ? ref[0] : (v - u->effective_half_track * w) / u->wheel_radius;
    row[7] = model == KINEMATIC ? ref[1] : (v + u->effective_half_track * w) / u->wheel_radius;
    row[8] = torque[0], row[9] = torque[1], row[10] = row[11] = row[12] = turn;
  }
  return yaw; /* the caller uses it, so nothing is optimised away */
}
