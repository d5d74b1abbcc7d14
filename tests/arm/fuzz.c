/* Random calls of a filter, CALLS of them: whatever comes, nothing traps, and the state is finite or says that it failed. The
 * same on the host, under sanitizers, and on a board. Ends with 0, or with what went wrong.
 */
#include <math.h>
#include <stdint.h>

#include "ins_gps.h"
#include "ins_gps_align.h"

#ifndef CALLS
#define CALLS 10000
#endif

static InsGps filter;
static InsGpsAlign align;
static InsGpsWatch watch;
static InsGpsState state;
static uint32_t seed = 1u;

/* xorshift (Marsaglia, 2003) */
static uint32_t pick(uint32_t n)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed % n;
}

static double odd(void)
{
    static const double values[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e38, -1e38, 5e-324, 0.0, -0.0, 1.0, 1e10};
    return values[pick(sizeof values / sizeof values[0])];
}

static ins_gps_real number(double size)
{
    return (ins_gps_real)(pick(200) ? size * ((double)pick(2001) * 0.001 - 1.0) : odd());
}

static bool all_finite(const ins_gps_real *x, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(x[i])) {
            return false;
        }
    }
    return true;
}

static void predict(double time)
{
    const ins_gps_real ax = number(5.0), rate = number(0.5);
#ifdef HAS_TILT
    const ins_gps_real ay = number(5.0), gx = number(0.1), gy = number(0.1);
    ins_gps_predict(&filter, time, ax, ay, (ins_gps_real)9.81 + number(1.0), gx, gy, rate);
    ins_gps_align_predict(&align, time, ax, ay, gx, gy, rate);
    ins_gps_watch_sample(&watch, &filter, time, ax, ay, gx, gy, rate);
#else
    ins_gps_predict(&filter, time, ax, number(5.0), rate);
    ins_gps_align_predict(&align, time, ax, rate);
    ins_gps_watch_sample(&watch, &filter, time, ax, rate);
#endif
}

static void update(double time)
{
    const ins_gps_real velocity[2] = {number(20.0), number(20.0)}, x = number(100.0), y = number(100.0);
    const ins_gps_real *given = pick(2) ? velocity : 0;
    ins_gps_real mean[5], covariance[25];
#ifdef HAS_STD
    const ins_gps_real std[2] = {number(3.0), number(3.0)};
    ins_gps_update(&filter, time, x, y, given, std);
    ins_gps_watch_fix(&watch, time, x, y, std);
#else
    ins_gps_update(&filter, time, x, y, given);
    ins_gps_watch_fix(&watch, time, x, y);
#endif
    if (ins_gps_align_fix(&align, time, x, y, mean, covariance)) {
        if (!all_finite(mean, 5) || !all_finite(covariance, 25)) {
            seed = 0u; /* tells main */
        } else if (pick(8) == 0) {
            ins_gps_init(&filter, time, mean, covariance, 0);
            ins_gps_tell_gyro(&filter, &align.gyro);
        }
    }
#ifdef HAS_ODOMETER
    ins_gps_odometer(&filter, time + 0.01 * (double)pick(3), number(20.0));
#endif
}

int main(void)
{
    static const ins_gps_real mean[5] = {0, 0, 10, 0, 0};
    ins_gps_real covariance[25] = {0};
    double time = 0.0, step = 0.001;
    long failures = 0, lived = 0;
    for (int i = 0; i < 25; i += 6) {
        covariance[i] = 1;
    }
    for (long call = 0, left = 0; call < CALLS; call++, left--) {
        if (left == 0) { /* a run of its own */
            left = 1 + (long)pick(800);
            step = pick(2) ? 0.001 : 0.02; /* s: a fast IMU, or a slow one, whose fixes reach back far */
            time = pick(4) ? 0.0 : pick(2) ? 1.7e9 : -50.0;
            ins_gps_init(&filter, time, mean, covariance, pick(2) ? mean : 0);
            ins_gps_align_init(&align, 0);
            ins_gps_watch_init(&watch, time, 0);
        }
        time += step * ((double)pick(20) - 2.0 * (double)(pick(8) == 0));
        const double at = pick(100) ? time : pick(2) ? odd() : time + (double)pick(40) - 20.0;
        if (pick(3)) {
            predict(at);
        } else {
            for (uint32_t n = pick(100) ? 1 : 2 * INS_GPS_FIXES; n > 0; n--) { /* now and then a flood of late ones */
                update(at - 0.1 * (double)pick(4) + 1e-4 * n);
            }
        }
        if (seed == 0u) {
            return 2;
        }
        ins_gps_state(&filter, &state);
        const bool finite = all_finite(state.mean, INS_GPS_STATES) && all_finite(state.covariance[0], INS_GPS_STATES * INS_GPS_STATES);
        if (!finite && !state.failed) {
            return 3;
        }
        failures += state.failed;
        lived += !state.failed;
    }
    return failures > 0 && lived > CALLS / 4 ? 0 : 4; /* it must have seen both */
}
