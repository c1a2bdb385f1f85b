// SPDX-License-Identifier: GPL-3.0-or-later
// Stub of SDK 2's header, from its public documentation: it prints its calls to stderr.

#pragma once

#include <cstddef>
#include <cstdio>

namespace Ultrahaptics {
namespace AmplitudeModulation {

struct ControlPoint {
    ControlPoint(float x, float y, float z, float intensity, float frequency = 125.0f)
        : x(x), y(y), z(z), intensity(intensity), frequency(frequency) {}
    float x, y, z, intensity, frequency;
};

class Emitter {
public:
    bool update(const ControlPoint *points, std::size_t count) {
        std::fprintf(stderr, "update");
        for (std::size_t i = 0; i < count; ++i)
            std::fprintf(stderr, " %.4f,%.4f,%.4f,%.4f,%.1f", points[i].x, points[i].y, points[i].z,
                         points[i].intensity, points[i].frequency);
        std::fprintf(stderr, "\n");
        return true;
    }
    bool stop() {
        std::fprintf(stderr, "stop\n");
        return true;
    }
    bool isConnected() const { return true; }
    std::size_t getMaximumControlPointLimit() const { return 4; }
};

}  // namespace AmplitudeModulation
}  // namespace Ultrahaptics
