// A publisher that a control loop never waits for, as far as it is used.
#pragma once
#include <memory>
namespace realtime_tools {
template <class Message> struct RealtimePublisher {
  explicit RealtimePublisher(std::shared_ptr<rclcpp::Publisher<Message>> publisher);
  bool trylock();
  void unlockAndPublish();
  Message msg_;
};
}  // namespace realtime_tools
