// SPDX-License-Identifier: GPL-3.0-or-later
// What the bridge asks of an SDK; sdk2.cpp and sdk3.cpp each answer it.

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
    // Most points at a time.
    virtual std::size_t limit() = 0;
    // Emits these points from now on. Throws ArrayError.
    virtual void emit(const FociMessage &points) = 0;
    // Ends all sound. Throws ArrayError.
    virtual void stop() = 0;
    virtual bool connected() = 0;
};

constexpr float modulation_frequency = 200.0f;  // Hz

// Connects to the first array. Throws ArrayError.
std::unique_ptr<Array> connect_array();

}  // namespace tactile_clay
