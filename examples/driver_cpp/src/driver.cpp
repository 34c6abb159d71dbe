// Copyright 2026 starcal_ros contributors
// SPDX-License-Identifier: Apache-2.0
//
// Publishes gyro readings and star centroids of a device: an example driver, ../driver.py in C++.
//
//   cat /dev/ttyUSB0 | ros2 run starcal_driver driver
//
// The device of this example speaks lines, one a reading and one a frame:
//
//   gyro STAMP_NS WX WY WZ                end of the interval; mean rate over it [rad/s]
//   stars STAMP_NS {U V HIP SIGMA MAG}    middle of the exposure; raster pixels, 0: not known
//
// Stamps are UTC, in ns since the Unix epoch.

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/imu.hpp"
#include "sensor_msgs/msg/point_cloud2.hpp"
#include "sensor_msgs/msg/point_field.hpp"

using sensor_msgs::msg::Imu;
using sensor_msgs::msg::PointCloud2;
using sensor_msgs::msg::PointField;

// A star as it lies in 28 bytes.
struct Field
{
  const char * name;
  std::uint32_t offset;
  std::uint8_t datatype;
};
constexpr Field kFields[] = {
  {"u", 0, PointField::FLOAT64}, {"v", 8, PointField::FLOAT64},
  {"catalog_id", 16, PointField::UINT32}, {"sigma", 20, PointField::FLOAT32},
  {"magnitude", 24, PointField::FLOAT32}};
constexpr std::uint32_t kPointStep = 28;

struct Line
{
  std::string kind;
  std::int64_t stamp_ns;
  std::vector<double> values;
};

// Stamp and numbers of a line; nothing where it has anything else.
std::optional<Line> read_line(const std::string & text)
{
  std::istringstream stream(text);
  Line line{};
  if (!(stream >> line.kind >> line.stamp_ns) || line.stamp_ns < 0) {
    return std::nullopt;
  }
  std::string word;
  while (stream >> word) {
    char * end = nullptr;
    line.values.push_back(std::strtod(word.c_str(), &end));      // takes nan as well
    if (*end != '\0') {
      return std::nullopt;
    }
  }
  return line;
}

std_msgs::msg::Header header(std::int64_t stamp_ns, const char * frame_id)
{
  std_msgs::msg::Header made;
  made.stamp.sec = static_cast<std::int32_t>(stamp_ns / 1'000'000'000);
  made.stamp.nanosec = static_cast<std::uint32_t>(stamp_ns % 1'000'000'000);
  made.frame_id = frame_id;
  return made;
}

Imu imu(const Line & line)
{
  Imu message;
  message.header = header(line.stamp_ns, "gyro");
  message.angular_velocity.x = line.values[0];
  message.angular_velocity.y = line.values[1];
  message.angular_velocity.z = line.values[2];
  // What is not measured says so (REP-145).
  message.orientation_covariance[0] = -1.0;
  message.linear_acceleration_covariance[0] = -1.0;
  return message;
}

template<typename T>
void put(PointCloud2 & message, std::size_t place, double value)
{
  const T stored = static_cast<T>(value);
  std::memcpy(&message.data[place], &stored, sizeof(T));
}

PointCloud2 cloud(const Line & line)
{
  const std::size_t stars = line.values.size() / 5;
  PointCloud2 message;
  message.header = header(line.stamp_ns, "star_tracker_optical");
  message.height = 1;
  message.width = static_cast<std::uint32_t>(stars);
  for (const auto & field : kFields) {
    PointField made;
    made.name = field.name;
    made.offset = field.offset;
    made.datatype = field.datatype;
    made.count = 1;
    message.fields.push_back(made);
  }
  message.is_bigendian = false;
  message.point_step = kPointStep;
  message.row_step = static_cast<std::uint32_t>(kPointStep * stars);
  message.is_dense = true;
  message.data.resize(kPointStep * stars);
  for (std::size_t k = 0; k < stars; ++k) {
    const double * star = &line.values[5 * k];
    put<double>(message, kPointStep * k, star[0]);
    put<double>(message, kPointStep * k + 8, star[1]);
    put<std::uint32_t>(message, kPointStep * k + 16, star[2]);
    put<float>(message, kPointStep * k + 20, star[3]);
    put<float>(message, kPointStep * k + 24, star[4]);
  }
  return message;
}

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  auto node = std::make_shared<rclcpp::Node>("star_tracker_driver");
  // Reliable, and some seconds deep: none may be lost.
  auto gyro = node->create_publisher<Imu>("imu/data_raw", rclcpp::QoS(1000).reliable());
  auto stars = node->create_publisher<PointCloud2>(
    "star_tracker/centroids", rclcpp::QoS(50).reliable());
  for (std::string text; rclcpp::ok() && std::getline(std::cin, text); ) {
    if (text.find_first_not_of(" \t\r") == std::string::npos) {
      continue;
    }
    const auto line = read_line(text);
    if (line && line->kind == "gyro" && line->values.size() == 3) {
      gyro->publish(imu(*line));
    } else if (line && line->kind == "stars" && line->values.size() % 5 == 0) {
      stars->publish(cloud(*line));
    } else {
      RCLCPP_WARN_THROTTLE(
        node->get_logger(), *node->get_clock(), 1000, "passed over: %s", text.c_str());
    }
  }
  // What was sent last arrives before the node goes.
  gyro->wait_for_all_acked(std::chrono::seconds(5));
  stars->wait_for_all_acked(std::chrono::seconds(5));
  rclcpp::shutdown();
  return 0;
}
