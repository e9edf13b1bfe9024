/* The planar models' loop in C, as one would write it by hand: the yardstick of benchmarks/simulate.py.
 *
 * Same arithmetic as ssmr/simulate.py and ssmr/models, the command turned into wheel-rate references beforehand, and the same thirteen numbers
 * written of every step. Returns the final yaw, so that nothing is optimised away. */
#include <math.h>

enum { COULOMB, IMPROVED, LINEAR, KINEMATIC };

typedef struct {
  double mass, inertia, r, c, c_eff, a, b, x_icr, g;
} vehicle_t;

static double sign(double x) { return (x > 0.0) - (x < 0.0); }
static double clip(double x, double limit) { return fmin(fmax(x, -limit), limit); }

static void torques(double v, double w, const double *ref, const vehicle_t *u, double gain, double limit, double *left, double *right) {
  *left = clip(gain * (ref[0] - (v - u->c_eff * w) / u->r), limit);
  *right = clip(gain * (ref[1] - (v + u->c_eff * w) / u->r), limit);
}

static void coulomb_rates(double v, double w, const double *ref, const vehicle_t *u, const double *p, double limit, const double *resist,
                          double *dv, double *dw) {
  double left, right;
  torques(v, w, ref, u, p[2], limit, &left, &right);
  *dv = ((left + right) / u->r - resist[0] - u->mass * u->x_icr * w * w) / u->mass;
  *dw = (u->c * (right - left) / u->r - resist[1] + u->mass * u->x_icr * w * v) / (u->inertia + u->mass * u->x_icr * u->x_icr);
}

static void coulomb(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const double *p, double limit, double *torque) {
  double front = u->mass * u->g * u->a / (2.0 * (u->a + u->b)), rear = u->mass * u->g * u->b / (2.0 * (u->a + u->b));
  double s_left = sign(*v - u->c * *w), s_right = sign(*v + u->c * *w);
  double f_front = 2.0 * p[1] * front * sign((u->b - u->x_icr) * *w), f_rear = 2.0 * p[1] * rear * sign((-u->a - u->x_icr) * *w);
  double left = p[0] * (front + rear) * s_left, right = p[0] * (front + rear) * s_right;
  double resist[2] = {left + right, u->b * f_front - u->a * f_rear + u->c * (right - left) - u->x_icr * (f_front + f_rear)};
  double dv, dw, dv2, dw2;
  coulomb_rates(*v, *w, ref, u, p, limit, resist, &dv, &dw);
  coulomb_rates(*v + dt * dv, *w + dt * dw, ref, u, p, limit, resist, &dv2, &dw2);
  torques(*v, *w, ref, u, p[2], limit, torque, torque + 1);
  *v += 0.5 * dt * (dv + dv2);
  *w += 0.5 * dt * (dw + dw2);
}

static double dry(double active, double fs, double fd, double v) {
  if (v == 0.0) return fabs(active) <= fs ? -active : -sign(active) * fs;
  return -sign(v) * fd;
}

static void improved(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const double *p, double limit, double *torque) {
  double left, right, load = u->mass * u->g, lever = load * 2.0 * u->a * u->b / (u->a + u->b);
  torques(*v, *w, ref, u, p[3], limit, &left, &right);
  torque[0] = left, torque[1] = right;
  double force = (left + right) / u->r, moment = u->c * (right - left) / u->r;
  double f = dry(force, p[0] * load, p[0] * load, *v), m = dry(moment, p[1] * lever, p[2] * lever, *w);
  int stuck = *v == 0.0 && f == -force, stuck_yaw = *w == 0.0 && m == -moment;
  double dv = stuck ? 0.0 : (force + f) / u->mass, dw = stuck_yaw ? 0.0 : (moment + m) / u->inertia;
  torques(*v + dt * dv, *w + dt * dw, ref, u, p[3], limit, &left, &right);
  double dv2 = stuck ? 0.0 : ((left + right) / u->r + f) / u->mass;
  double dw2 = stuck_yaw ? 0.0 : (u->c * (right - left) / u->r + m) / u->inertia;
  double v2 = *v + 0.5 * dt * (dv + dv2), w2 = *w + 0.5 * dt * (dw + dw2);
  *v = v2 * *v < 0.0 ? 0.0 : v2;
  *w = w2 * *w < 0.0 ? 0.0 : w2;
}

static void linear(double *v, double *w, const double *ref, double dt, const vehicle_t *u, const double *p, double limit, double *torque) {
  double loop = 2.0 * p[2] / (u->r * u->mass), friction = 4.0 * u->g * p[0];
  double loop_yaw = 2.0 * p[2] * u->c / (u->r * u->inertia), friction_yaw = u->mass * u->g * p[1] * u->c / u->inertia;
  double vl = u->r * ref[0], vr = u->r * ref[1];
  double left = clip(p[2] * (vl - *v + u->c_eff * *w), limit), right = clip(p[2] * (vr - *v - u->c_eff * *w), limit);
  torque[0] = left, torque[1] = right;
  double rate_v, drive_v, rate_w, drive_w;
  if (fabs(left) < limit && fabs(right) < limit) {
    rate_v = loop + friction, drive_v = loop * 0.5 * (vl + vr);
    rate_w = loop_yaw * u->c_eff + friction_yaw, drive_w = loop_yaw * 0.5 * (vr - vl);
  } else {
    rate_v = friction, drive_v = (left + right) / (u->r * u->mass);
    rate_w = friction_yaw, drive_w = u->c * (right - left) / (u->r * u->inertia);
  }
  *v += expm1(-rate_v * dt) * (*v - drive_v / rate_v);
  *w += expm1(-rate_w * dt) * (*w - drive_w / rate_w);
}

double simulate(int model, long n, const double *refs, double dt, const vehicle_t *u, const double *p, double limit, double *out) {
  double x = 0.0, y = 0.0, yaw = 0.0, v = 0.0, w = 0.0;
  double x_icr = model == COULOMB ? u->x_icr : model == KINEMATIC ? p[2] : 0.0;
  for (long k = 0; k < n; k++) {
    const double *ref = refs + 2 * k;
    double v0 = v, w0 = w, torque[2] = {0.0, 0.0};
    switch (model) {
      case COULOMB: coulomb(&v, &w, ref, dt, u, p, limit, torque); break;
      case IMPROVED: improved(&v, &w, ref, dt, u, p, limit, torque); break;
      case LINEAR: linear(&v, &w, ref, dt, u, p, limit, torque); break;
      default:
        w = (p[1] * u->r * ref[1] - p[0] * u->r * ref[0]) / (p[3] - p[4]);
        v = p[0] * u->r * ref[0] + w * p[3];
    }
    double vm = 0.5 * (v0 + v), wm = 0.5 * (w0 + w), heading = yaw + 0.5 * dt * wm, c = cos(heading), s = sin(heading);
    x += dt * (vm * c + x_icr * wm * s);
    y += dt * (vm * s - x_icr * wm * c);
    yaw += dt * wm;
    double turn = (w - w0) / dt;
    double *row = out + 13 * k;
    row[0] = x, row[1] = y, row[2] = yaw, row[3] = v, row[4] = -x_icr * w, row[5] = w;
    row[6] = model == KINEMATIC ? ref[0] : (v - u->c_eff * w) / u->r, row[7] = model == KINEMATIC ? ref[1] : (v + u->c_eff * w) / u->r;
    row[8] = torque[0], row[9] = torque[1], row[10] = row[11] = row[12] = turn;
  }
  return yaw;
}
