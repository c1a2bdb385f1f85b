/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Implements LeapC's documented interface: two hands, then one of them corrupt, then timeouts. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#pragma pack(1)
typedef struct { float v[3]; } vector;
typedef struct { vector prev_joint, next_joint; float width; float rotation[4]; } bone;
typedef struct { int32_t finger_id; bone bones[4]; uint32_t is_extended; } digit;
typedef struct {
    vector position, stabilized_position, velocity, normal;
    float width;
    vector direction;
    float orientation[4];
} palm;
typedef struct {
    uint32_t id, flags;
    int32_t type;
    float confidence;
    uint64_t visible_time;
    float pinch_distance, grab_angle, pinch_strength, grab_strength;
    palm palm;
    digit digits[5];
    bone arm;
} hand;
typedef struct {
    void *reserved;
    int64_t frame_id, timestamp;
    int64_t tracking_frame_id;
    uint32_t hand_count;
    hand *hands;
    float framerate;
} tracking_event;
typedef struct { uint32_t size; int32_t type; const void *event; uint32_t device_id; } message;

static int polls, opened;
static hand hands[2];
static tracking_event event;

/* The 26 joints of each hand in millimeters, set by the test. */
float joints[2][26][3];

int64_t LeapGetNow(void) { return 9000000; }

int32_t LeapCreateConnection(const void *config, void **connection) {
    *connection = malloc(1);
    return 0;
}

int32_t LeapOpenConnection(void *connection) { opened = 1; return 0; }

static vector at(int side, int joint) {
    vector result;
    memcpy(result.v, joints[side][joint], sizeof result.v);
    return result;
}

static void fill(hand *h, int side) {
    memset(h, 0, sizeof *h);
    h->id = 10 + side;
    h->type = side;
    h->confidence = 1.0f;
    h->palm.position = at(side, 0);
    h->palm.normal.v[1] = -1.0f;
    h->palm.direction.v[2] = -1.0f;
    h->arm.next_joint = at(side, 1);
    for (int finger = 0; finger < 5; finger++) {
        /* The thumb's metacarpal has zero length. */
        int first = finger ? 1 + 5 * finger : 2;
        for (int b = 0; b < 4; b++) {
            int from = finger ? first + b : first + (b ? b - 1 : 0);
            int to = finger ? first + b + 1 : first + b;
            h->digits[finger].bones[b].prev_joint = at(side, from);
            h->digits[finger].bones[b].next_joint = at(side, to);
            h->digits[finger].bones[b].width = 18.0f;
        }
    }
}

int32_t LeapPollConnection(void *connection, uint32_t timeout, message *m) {
    if (!opened || m->size != sizeof *m) return (int32_t)0xE2010001;
    m->event = NULL;
    switch (polls++) {
    case 0: return (int32_t)0xE2010005;
    case 1: m->type = 1; return 0;
    case 2: m->type = 3; return 0;
    case 3:
    case 4:
        fill(&hands[0], 1);
        fill(&hands[1], 0);
        if (polls == 5) hands[0].digits[2].bones[3].next_joint = hands[0].digits[2].bones[3].prev_joint;
        event.timestamp = 8990000;
        event.hand_count = 2;
        event.hands = hands;
        m->type = 0x100;
        m->event = &event;
        return 0;
    default: return (int32_t)0xE2010004;
    }
}

void LeapCloseConnection(void *connection) { opened = 0; }
void LeapDestroyConnection(void *connection) { free(connection); }
