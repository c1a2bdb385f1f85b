// SPDX-License-Identifier: GPL-3.0-or-later
// Ultrahaptics SDK 2: the array itself modulates focal points, which persist until the next update.

#include <UltrahapticsAmplitudeModulation.hpp>

#include "array.hpp"

namespace tactile_clay {
namespace {

class ArraySDK2 : public Array {
public:
    ArraySDK2() {
        if (!emitter_.isConnected()) throw ArrayError("no array is connected");
    }
    ~ArraySDK2() override { emitter_.stop(); }

    std::size_t limit() override { return emitter_.getMaximumControlPointLimit(); }

    void emit(const FociMessage &points) override {
        if (points.points.empty()) return stop();
        std::vector<Ultrahaptics::AmplitudeModulation::ControlPoint> control;
        for (const FocalPoint &one : points.points)
            // The frequency is always given, because the default differs from the documentation.
            control.emplace_back(one.x, one.y, one.z, one.intensity, modulation_frequency);
        if (!emitter_.update(control.data(), control.size()))
            throw ArrayError("the array does not accept the focal points");
    }

    void stop() override {
        if (!emitter_.stop()) throw ArrayError("the array does not stop");
    }

    bool connected() override { return emitter_.isConnected(); }

private:
    Ultrahaptics::AmplitudeModulation::Emitter emitter_;
};

}  // namespace

std::unique_ptr<Array> connect_array() { return std::make_unique<ArraySDK2>(); }

}  // namespace tactile_clay
