/* The smallest driver: a wall 2.5 m ahead, 20 times a second, for as many seconds as the second argument says.
 *
 *     publish_wall INSTANCE SECONDS [KEY_FILE]                                                              */

#define _POSIX_C_SOURCE 200809L
#include "vigil_depth.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int argc, char **argv) {
    static float ranges_m[VIGIL_DEPTH_PIXELS];
    const float position_ned_m[3] = {0.0f, 0.0f, -1.5f}, level_north[4] = {1.0f, 0.0f, 0.0f, 0.0f};
    if (argc < 3) {
        fprintf(stderr, "usage: publish_wall INSTANCE SECONDS [KEY_FILE]\n");
        return 2;
    }
    vigil_depth_publisher *publisher = vigil_depth_open((uint32_t)atoi(argv[1]), 1, argc > 3 ? argv[3] : NULL);
    if (!publisher) {
        fprintf(stderr, "%s\n", vigil_depth_error());
        return 1;
    }
    for (int frame = 0; frame < 20 * atoi(argv[2]); frame++) {
        for (int i = 0; i < VIGIL_DEPTH_PIXELS; i++)
            ranges_m[i] = 2.5f + 0.02f * ((float)rand() / (float)RAND_MAX - 0.5f);
        if (vigil_depth_publish(publisher, ranges_m, position_ned_m, level_north, vigil_depth_now_ns()) < 0) {
            fprintf(stderr, "%s\n", vigil_depth_error());
            return 1;
        }
        nanosleep(&(struct timespec){.tv_nsec = 50000000}, NULL);
    }
    vigil_depth_close(publisher);
    return 0;
}
