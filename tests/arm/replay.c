/* Replays a drive on a board: replay.bin, doubles as the host has them, to estimate.bin, one row a sample.
 *
 * replay.bin: START numbers of the start (see replay.c of the export), then EVENT numbers an event: what it is, its
 * time, its numbers. A row of estimate.bin: time, means, variances, then the instructions of ins_gps_predict(), those of
 * what was called since the sample before, how many fixes that were, and the instructions of ins_gps_state(). Last comes
 * one number, the stack in bytes.
 */
#include "board.h"
#include "ins_gps.h"
#include "ins_gps_align.h"

#include <string.h>
#include <math.h>

enum { START = 64, EVENT = 8, AT_ONCE = 64 };
enum { IMU, FIX, ODOMETER };

static InsGps filter;
static double events[AT_ONCE][EVENT];
static ins_gps_real numbers[EVENT];

static void sample(const ins_gps_real u[], double time)
{
#ifdef HAS_TILT
    ins_gps_predict(&filter, time, u[0], u[1], u[3], u[4], u[5], u[2]);
#else
    ins_gps_predict(&filter, time, u[0], u[1], u[2]);
#endif
}

static void fix(const ins_gps_real z[], double time)
{
    const ins_gps_real *velocity = isnan(z[2]) ? NULL : z + 2;
#ifdef HAS_STD
    static const ins_gps_real not_stated[2] = {0, 0};
    ins_gps_update(&filter, time, z[0], z[1], velocity, isnan(z[4]) ? not_stated : z + 4);
#else
    ins_gps_update(&filter, time, z[0], z[1], velocity);
#endif
}

static void reading(const ins_gps_real z[], double time)
{
#ifdef HAS_ODOMETER
    ins_gps_odometer(&filter, time, z[0]);
#else
    (void)z;
    (void)time;
#endif
}

static void start(const double given[START])
{
    ins_gps_real z[START];
    for (int i = 0; i < START; i++) {
        z[i] = (ins_gps_real)given[i];
    }
    const ins_gps_real lever_arm[3] = {z[1], z[2], z[33]};
    ins_gps_init(&filter, given[0], z + 3, z + 8, lever_arm);
#ifdef HAS_TILT
    const double *seen = given + 34;
#else
    const double *seen = given + 33;
#endif
    InsGpsGyro gyro;
    memcpy(&gyro, seen, sizeof gyro); /* it has only doubles */
    ins_gps_tell_gyro(&filter, &gyro);
}

int main(void)
{
    static double given[START];
    const int in = host_open("replay.bin", 0), out = host_open("estimate.bin", 1);
    if (in < 0 || out < 0 || !host_read(in, given, sizeof given)) {
        return 2;
    }
    start(given);
    stack_paint();
    double since = 0.0, fixes = 0.0;
    bool more = true;
    while (more) {
        for (int k = 0; k < AT_ONCE; k++) {
            events[k][0] = -1.0;
        }
        more = host_read(in, events, sizeof events) != 0;
        for (int k = 0; k < AT_ONCE && events[k][0] >= 0.0; k++) {
            const int what = (int)events[k][0];
            const double time = events[k][1];
            for (int i = 2; i < EVENT; i++) {
                numbers[i - 2] = (ins_gps_real)events[k][i];
            }
            const uint32_t then = ticks();
            if (what == IMU) {
                sample(numbers, time);
            } else if (what == FIX) {
                fix(numbers, time);
            } else {
                reading(numbers, time);
            }
            const double cost = INSTRUCTIONS_A_TICK * (double)ticks_since(then);
            if (what != IMU) {
                since += cost;
                fixes += what == FIX;
                continue;
            }
            if (time > given[0]) {
                double row[2 * INS_GPS_STATES + 5];
                InsGpsState state;
                const uint32_t asked = ticks();
                ins_gps_state(&filter, &state);
                const double told = INSTRUCTIONS_A_TICK * (double)ticks_since(asked);
                row[0] = state.time;
                for (int i = 0; i < INS_GPS_STATES; i++) {
                    row[1 + i] = (double)state.mean[i];
                    row[1 + INS_GPS_STATES + i] = (double)state.covariance[i][i];
                }
                double *costs = row + 1 + 2 * INS_GPS_STATES;
                costs[0] = cost;
                costs[1] = since;
                costs[2] = fixes;
                costs[3] = told;
                if (!host_write(out, row, sizeof row)) {
                    return 3;
                }
            }
            since = fixes = 0.0;
        }
    }
    const double stack = (double)stack_used();
    return host_write(out, &stack, sizeof stack) ? 0 : 3;
}
