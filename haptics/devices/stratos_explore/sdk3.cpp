// SPDX-License-Identifier: GPL-3.0-or-later
// Ultraleap Haptics SDK 3: a callback provides the focal points of the next samples.

#include <ultraleap/haptics/streaming.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <string>

#include "array.hpp"

namespace tactile_clay {
namespace {

using namespace Ultraleap::Haptics;

// More simultaneous focal points lower the update rate of each.
constexpr std::size_t max_points = 8;
constexpr double pi = 3.14159265358979323846;

template <typename Result>
void check(const Result &result, const char *what) {
    if (!result) throw ArrayError(std::string(what) + ": " + result.error().message());
}

class ArraySDK3 : public Array {
public:
    ArraySDK3() : emitter_(connected_library(library_)) {
        auto found = library_.findDevice(DeviceFeatures::StreamingHaptics);
        check(found, "no array is found");
        check(emitter_.addDevice(found.value()), "the array cannot be used");
        check(emitter_.setControlPointCount(max_points, AdjustRate::All),
              "the array does not support that many focal points");
        check(emitter_.setEmissionCallback(
                  [this](const StreamingEmitter &, OutputInterval &interval, const LocalTimePoint &) {
                      fill(interval);
                  }),
              "the array does not accept the callback");
        start_ = LocalTimeClock::now();
        check(emitter_.start(), "the array does not start");
        check(emitter_.pause(), "the array does not pause");
    }
    ~ArraySDK3() override { (void)emitter_.stop(); }

    std::size_t limit() override { return max_points; }

    void emit(const FociMessage &points) override {
        if (points.points.empty()) return stop();
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            points_ = points;
        }
        if (!emitting_) check(emitter_.resume(), "the array does not resume");
        emitting_ = true;
    }

    void stop() override {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            points_.points.clear();
        }
        emitting_ = false;
        check(emitter_.pause(), "the array does not pause");
    }

    // If the array is gone, calls of the SDK fail.
    bool connected() override { return true; }

private:
    static Library &connected_library(Library &library) {
        check(library.connect(), "the Ultraleap service does not answer");
        return library;
    }

    void fill(OutputInterval &interval) {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (auto &sample : interval) {
            const std::chrono::duration<double> time = sample - start_;
            const double wave =
                points_.modulated
                    ? 0.5 * (1.0 - std::cos(2.0 * pi * modulation_frequency * time.count()))
                    : 1.0;
            for (std::size_t i = 0; i < max_points; ++i) {
                const bool used = i < points_.points.size();
                const FocalPoint one =
                    used ? points_.points[i] : FocalPoint{0.0f, 0.0f, 0.2f, 0.0f};
                sample.controlPoint(i).setPosition(Vector3(one.x, one.y, one.z));
                sample.controlPoint(i).setIntensity(static_cast<float>(one.intensity * wave));
            }
        }
    }

    Library library_;
    StreamingEmitter emitter_;
    LocalTimePoint start_;
    std::mutex mutex_;
    FociMessage points_;
    bool emitting_ = false;
};

}  // namespace

std::unique_ptr<Array> connect_array() { return std::make_unique<ArraySDK3>(); }

}  // namespace tactile_clay
