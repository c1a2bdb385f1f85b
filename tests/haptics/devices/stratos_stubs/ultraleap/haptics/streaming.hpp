// SPDX-License-Identifier: GPL-3.0-or-later
// Stub of SDK 3's header, from its public documentation: it calls back like the device, a thousand
// times per second with five samples each, and prints the results to stderr.

#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace Ultraleap {
namespace Haptics {

using LocalTimeClock = std::chrono::steady_clock;
using LocalTimePoint = LocalTimeClock::time_point;

struct Error {
    const char *message() const { return "none"; }
};

template <typename Value>
class result {
public:
    result(Value value) : value_(std::move(value)) {}
    explicit operator bool() const { return true; }
    Error error() const { return {}; }
    Value &value() { return value_; }

private:
    Value value_;
};

template <>
class result<void> {
public:
    explicit operator bool() const { return true; }
    Error error() const { return {}; }
};

struct Vector3 {
    Vector3() = default;
    Vector3(float x, float y, float z) : x(x), y(y), z(z) {}
    float x = 0, y = 0, z = 0;
};

enum class DeviceFeatures { StreamingHaptics };
enum class AdjustRate { None, All };
struct Device {};

class Library {
public:
    result<void> connect() { return {}; }
    result<Device> findDevice(DeviceFeatures) { return Device{}; }
};

class ControlPoint {
public:
    void setPosition(const Vector3 &value) { position = value; }
    void setIntensity(float value) { intensity = value; }
    Vector3 position;
    float intensity = 0;
};

class TimePointOnOutputInterval {
public:
    TimePointOnOutputInterval(LocalTimePoint time, std::size_t count) : time_(time), points_(count) {}
    ControlPoint &controlPoint(std::size_t index) { return points_.at(index); }
    std::chrono::duration<double> operator-(const LocalTimePoint &other) const {
        return time_ - other;
    }
    const std::vector<ControlPoint> &points() const { return points_; }

private:
    LocalTimePoint time_;
    std::vector<ControlPoint> points_;
};

using OutputInterval = std::vector<TimePointOnOutputInterval>;
class StreamingEmitter;
using EmissionCallbackFunction =
    std::function<void(const StreamingEmitter &, OutputInterval &, const LocalTimePoint &)>;

class StreamingEmitter {
public:
    explicit StreamingEmitter(Library &) {}
    result<void> addDevice(const Device &) { return {}; }
    result<void> setControlPointCount(std::size_t count, AdjustRate) {
        count_ = count;
        return {};
    }
    result<void> setEmissionCallback(EmissionCallbackFunction callback) {
        callback_ = std::move(callback);
        return {};
    }
    result<void> start() {
        running_ = true;
        thread_ = std::thread([this] { run(); });
        return {};
    }
    result<void> pause() {
        const std::lock_guard<std::mutex> lock(mutex_);
        std::fprintf(stderr, "pause\n");
        paused_ = true;
        return {};
    }
    result<void> resume() {
        std::fprintf(stderr, "resume\n");
        paused_ = false;
        return {};
    }
    result<void> stop() {
        running_ = false;
        if (thread_.joinable()) thread_.join();
        return {};
    }

private:
    void run() {
        while (running_) {
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
            const std::lock_guard<std::mutex> lock(mutex_);
            if (paused_) continue;
            const auto now = LocalTimeClock::now();
            OutputInterval interval;
            for (int i = 0; i < 5; ++i)
                interval.emplace_back(now + std::chrono::microseconds(200 * i), count_);
            callback_(*this, interval, now + std::chrono::milliseconds(1));
            for (const auto &sample : interval) {
                std::fprintf(stderr, "sample");
                for (const auto &one : sample.points())
                    std::fprintf(stderr, " %.4f,%.4f,%.4f,%.4f", one.position.x, one.position.y,
                                 one.position.z, one.intensity);
                std::fprintf(stderr, "\n");
            }
        }
    }

    std::size_t count_ = 0;
    EmissionCallbackFunction callback_;
    std::atomic<bool> running_{false}, paused_{true};
    std::mutex mutex_;  // A pause waits for the running callback.
    std::thread thread_;
};

}  // namespace Haptics
}  // namespace Ultraleap
