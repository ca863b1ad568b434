/* Publishes depth frames to Vigil: docs/sensor-interface.md is the interface.
 *
 *     cargo build --release -p vigil-sensors --example vigil_depth
 *     cc tools/publishers/c/publish_wall.c -I tools/publishers/c -L target/release/examples -lvigil_depth \
 *         -Wl,-rpath,target/release/examples
 *
 * A publisher belongs to the thread that opened it. Functions neither print nor exit. */

#ifndef VIGIL_DEPTH_H
#define VIGIL_DEPTH_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define VIGIL_DEPTH_ROWS 128
#define VIGIL_DEPTH_COLS 256
#define VIGIL_DEPTH_PIXELS (VIGIL_DEPTH_ROWS * VIGIL_DEPTH_COLS)

typedef struct vigil_depth_publisher vigil_depth_publisher;

/* Becomes the publisher of an instance (0 to 99; 0 is the usual one). sensor_id: the firmware's `sensor_id`, usually 1. key_file: the
 * secret of the frames' key (docs/frame-authentication.md), or NULL. NULL where it failed: see vigil_depth_error. */
vigil_depth_publisher *vigil_depth_open(uint32_t instance, uint32_t sensor_id, const char *key_file);

/* Publishes an image. Returns the number of readers, or -1: see vigil_depth_error; nothing was published then.
 * ranges_m: row by row from the top left, metres along each pixel's ray; infinity, NaN, 0 or less, or 100 to 1000: no return. Refused,
 * for no return reads as free space: an image without a single return, and one with more than 1000 (millimetres?).
 * position_ned_m, attitude_wxyz: the vehicle's estimate at capture, metres as in LOCAL_POSITION_NED, within 100 km; unit quaternion,
 * body (FRD) to NED.
 * stamp_ns: time of capture on CLOCK_MONOTONIC (vigil_depth_now_ns), at most a second ago; must rise. */
int vigil_depth_publish(vigil_depth_publisher *publisher, const float ranges_m[VIGIL_DEPTH_PIXELS],
                        const float position_ned_m[3], const float attitude_wxyz[4], uint64_t stamp_ns);

/* Makes the ranges of an image, as vigil_depth_publish takes them, of a point cloud. Returns the number of pixels with a range, or -1:
 * also where not one point was a measurement (no points, all without a return or not finite) or one is of another unit than metres.
 * points_frd_m: x, y, z of each point, metres in the sensor's axes forward, right, down; 0, 0, 0 is no return.
 * mount: metres forward, right and down of the vehicle's middle, then roll, pitch and yaw in radians.
 * across_deg, down_deg: angle between neighbouring beams, degrees. */
int vigil_depth_project_points(const float *points_frd_m, size_t points, const float mount[6], float across_deg,
                               float down_deg, float ranges_m[VIGIL_DEPTH_PIXELS]);

/* The same of a rectified depth image, row by row: depth along the camera's axis in units of metres_per_unit, 0 is no return.
 * intrinsics: fx, fy, cx, cy in pixels. metres_per_unit: 0.001 for most cameras, at most 0.1. */
int vigil_depth_project_image(const uint16_t *depth, uint32_t width, uint32_t height, const float intrinsics[4],
                              float metres_per_unit, const float mount[6], float ranges_m[VIGIL_DEPTH_PIXELS]);

/* CLOCK_MONOTONIC in nanoseconds. */
uint64_t vigil_depth_now_ns(void);

/* What went wrong last in this thread, and what to do; valid until the next call. Never NULL. */
const char *vigil_depth_error(void);

/* Ends the publisher. NULL is allowed. */
void vigil_depth_close(vigil_depth_publisher *publisher);

#ifdef __cplusplus
}
#endif

#endif
