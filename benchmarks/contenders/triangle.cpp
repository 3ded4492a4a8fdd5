// Hand-written EKF-SLAM: range and bearing, known ids, one triangle of the covariance.
//
// P is the lower triangle, row-major with rows of length `ld`; entries above the diagonal are never touched.
// A prediction changes only the columns of the pose, O(D); each sighting is a symmetric rank-2 downdate, O(D^2).

#include <cmath>

namespace {

const double PI = 3.14159265358979323846;

struct Filter {
    double *x, *P, *w0, *w1;
    long ld, D;

    double *row(long i) const { return P + i * ld; }
};

struct Noise {
    double speed, turn, range, bearing;  // standard deviations
};

double wrap(double angle) { return angle - 2 * PI * std::floor((angle + PI) / (2 * PI)); }

// The exact arc of a unicycle with noise on speed and turn rate.
void predict(Filter &f, double v, double omega, double dt, const Noise &noise) {
    const double a = 0.5 * omega * dt, s2 = a * a;
    const bool small = std::fabs(a) < 1e-2;
    const double sinc = small ? 1 - s2 / 6 * (1 - s2 / 20) : std::sin(a) / a;
    const double slope = small ? -a / 3 * (1 - s2 / 10) : (std::cos(a) - sinc) / a;  // d sinc / da
    const double c = std::cos(f.x[2] + a), s = std::sin(f.x[2] + a);
    const double chord = v * dt * sinc, dx = chord * c, dy = chord * s;
    f.x[0] += dx;
    f.x[1] += dy;
    f.x[2] = wrap(f.x[2] + omega * dt);
    for (long i = 3; i < f.D; ++i) {
        double *p = f.row(i);
        p[0] -= dy * p[2];
        p[1] += dx * p[2];
    }
    double *p0 = f.row(0), *p1 = f.row(1), *p2 = f.row(2);
    const double p00 = p0[0], p10 = p1[0], p11 = p1[1], p20 = p2[0], p21 = p2[1], p22 = p2[2];
    const double longer = 0.5 * v * dt * dt * slope, turned = 0.5 * dt * chord;
    const double g[3][2] = {{dt * sinc * c, longer * c - turned * s}, {dt * sinc * s, longer * s + turned * c}, {0, dt}};
    const double qv = noise.speed * noise.speed, qw = noise.turn * noise.turn;
    const auto q = [&](int i, int j) { return g[i][0] * qv * g[j][0] + g[i][1] * qw * g[j][1]; };
    p0[0] = p00 - 2 * dy * p20 + dy * dy * p22 + q(0, 0);
    p1[0] = p10 + dx * p20 - dy * p21 - dx * dy * p22 + q(1, 0);
    p1[1] = p11 + 2 * dx * p21 + dx * dx * p22 + q(1, 1);
    p2[0] = p20 - dy * p22 + q(2, 0);
    p2[1] = p21 + dx * p22 + q(2, 1);
    p2[2] = p22 + q(2, 2);
}

// Update by one sighting of the landmark whose coordinates begin at l.
void update(Filter &f, long l, double range, double bearing, const Noise &noise) {
    double *__restrict w0 = f.w0, *__restrict w1 = f.w1;
    const double dx = f.x[l] - f.x[0], dy = f.x[l + 1] - f.x[1];
    const double q = dx * dx + dy * dy, r = std::sqrt(q);
    const double a0 = dx / r, b0 = dy / r, a1 = -dy / q, b1 = dx / q;  // by the landmark; negative by the position
    const double *p0 = f.row(0), *p1 = f.row(1), *p2 = f.row(2), *l0 = f.row(l), *l1 = f.row(l + 1);
    const auto set = [&](long i, double px, double py, double pt, double lx, double ly) {
        w0[i] = a0 * (lx - px) + b0 * (ly - py);
        w1[i] = a1 * (lx - px) + b1 * (ly - py) - pt;
    };
    // w = H P, entry by entry from the lower triangle.
    set(0, p0[0], p1[0], p2[0], l0[0], l1[0]);
    set(1, p1[0], p1[1], p2[1], l0[1], l1[1]);
    set(2, p2[0], p2[1], p2[2], l0[2], l1[2]);
    for (long i = 3; i < l; ++i) {
        const double *p = f.row(i);
        set(i, p[0], p[1], p[2], l0[i], l1[i]);
    }
    set(l, l0[0], l0[1], l0[2], l0[l], l1[l]);
    set(l + 1, l1[0], l1[1], l1[2], l1[l], l1[l + 1]);
    for (long i = l + 2; i < f.D; ++i) {
        const double *p = f.row(i);
        set(i, p[0], p[1], p[2], p[l], p[l + 1]);
    }
    const double s00 = a0 * (w0[l] - w0[0]) + b0 * (w0[l + 1] - w0[1]) + noise.range * noise.range;
    const double s10 = a0 * (w1[l] - w1[0]) + b0 * (w1[l + 1] - w1[1]);
    const double s11 = a1 * (w1[l] - w1[0]) + b1 * (w1[l + 1] - w1[1]) - w1[2] + noise.bearing * noise.bearing;
    const double c00 = std::sqrt(s00), c10 = s10 / c00, c11 = std::sqrt(s11 - c10 * c10);
    const double i00 = 1 / c00, i11 = 1 / c11;
    const double t0 = (range - r) * i00;
    const double t1 = (wrap(bearing - std::atan2(dy, dx) + f.x[2]) - c10 * t0) * i11;
    for (long i = 0; i < f.D; ++i) {
        w0[i] *= i00;
        w1[i] = (w1[i] - c10 * w0[i]) * i11;
        f.x[i] += w0[i] * t0 + w1[i] * t1;
    }
    f.x[2] = wrap(f.x[2]);
    for (long i = 0; i < f.D; ++i) {
        double *__restrict p = f.row(i);
        const double u = w0[i], v = w1[i];
        for (long j = 0; j <= i; ++j) p[j] -= u * w0[j] + v * w1[j];
    }
}

// Append a landmark from its first sighting.
void augment(Filter &f, double range, double bearing, const Noise &noise) {
    const long l = f.D;
    const double angle = f.x[2] + bearing, c = std::cos(angle), s = std::sin(angle);
    const double ex = range * c, ey = range * s;
    f.x[l] = f.x[0] + ex;
    f.x[l + 1] = f.x[1] + ey;
    double *n0 = f.row(l), *n1 = f.row(l + 1);
    const double *p0 = f.row(0), *p1 = f.row(1), *p2 = f.row(2);
    n0[0] = p0[0] - ey * p2[0], n0[1] = p1[0] - ey * p2[1], n0[2] = p2[0] - ey * p2[2];
    n1[0] = p1[0] + ex * p2[0], n1[1] = p1[1] + ex * p2[1], n1[2] = p2[1] + ex * p2[2];
    for (long i = 3; i < l; ++i) {
        const double *p = f.row(i);
        n0[i] = p[0] - ey * p[2];
        n1[i] = p[1] + ex * p[2];
    }
    const double rr = noise.range * noise.range, bb = noise.bearing * noise.bearing;
    n0[l] = n0[0] - ey * n0[2] + c * c * rr + ey * ey * bb;
    n1[l] = n1[0] - ey * n1[2] + c * s * rr - ex * ey * bb;
    n1[l + 1] = n1[1] + ex * n1[2] + s * s * rr + ex * ex * bb;
    f.D += 2;
}

}  // namespace

// Take the steps begin ... end-1. Step k applies u[k] for dt[k], then the sightings first[k] ... first[k+1]-1.
// A sighting whose slot is the present length of the state appends a landmark. Returns the final length of the state.
extern "C" long triangle_run(double *x, double *P, long ld, long D, double *scratch, const double *u, const double *dt,
                             const long *first, const long *slot, const double *z, long begin, long end,
                             const double *sigmas) {
    Filter f{x, P, scratch, scratch + ld, ld, D};
    const Noise noise{sigmas[0], sigmas[1], sigmas[2], sigmas[3]};
    for (long k = begin; k < end; ++k) {
        predict(f, u[2 * k], u[2 * k + 1], dt[k], noise);
        for (long m = first[k]; m < first[k + 1]; ++m) {
            if (slot[m] < f.D)
                update(f, slot[m], z[2 * m], z[2 * m + 1], noise);
            else
                augment(f, z[2 * m], z[2 * m + 1], noise);
        }
    }
    return f.D;
}

// Read and write the lower triangle once: the least cost of a filter that touches all of P.
extern "C" void triangle_pass(double *P, long ld, long D, double factor) {
    for (long i = 0; i < D; ++i) {
        double *p = P + i * ld;
        for (long j = 0; j <= i; ++j) p[j] *= factor;
    }
}
