// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#pragma once

#include <type_traits>

#define PLUGINLIB_EXPORT_CLASS(Plugin, Base) static_assert(std::is_base_of_v<Base, Plugin>);
