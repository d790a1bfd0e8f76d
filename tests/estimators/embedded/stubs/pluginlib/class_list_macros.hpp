// What registers a plug-in: here, that the class is one of the base.
#pragma once
#include <type_traits>
#define PLUGINLIB_EXPORT_CLASS(Class, Base) static_assert(std::is_base_of<Base, Class>::value, "");
