// SPDX-License-Identifier: GPL-3.0-or-later
// The interface between the bridge and an SDK, implemented by sdk2.cpp and sdk3.cpp.

#pragma once

#include <cstddef>
#include <memory>
#include <stdexcept>

#include "focal_points.hpp"

namespace tactile_clay {

struct ArrayError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

class Array {
public:
    virtual ~Array() = default;
    // Maximum number of simultaneous focal points.
    virtual std::size_t limit() = 0;
    // Replaces the emitted focal points. Throws ArrayError.
    virtual void emit(const FociMessage &points) = 0;
    // Silences the array. Throws ArrayError.
    virtual void stop() = 0;
    virtual bool connected() = 0;
};

constexpr float modulation_frequency = 200.0f;  // Hz

// Connects to the first array. Throws ArrayError.
std::unique_ptr<Array> connect_array();

}  // namespace tactile_clay
