// ORB-SLAM3 behind the pipes of slam_node: docs/reference/slam_protocol.md.
//
//     orb_slam3_adapter VOCABULARY SETTINGS mono|stereo|stereo-inertial
//
// It uses the public interface of ORB-SLAM3 1.0 (System.h), which is GPL-3.0. This file is
// Apache-2.0; a binary of both may be passed on under the GPL-3.0 only.

#include <System.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <iostream>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <vector>

namespace {

static_assert(sizeof(double) == 8, "doubles of 64 bits");
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the protocol is little-endian, and so must be this machine"
#endif

constexpr std::uint16_t kVersion = 1;
constexpr std::uint32_t kMostBytes = 1u << 28;
constexpr int kTrackingOk = 2;    // Tracking::OK of ORB-SLAM3
// ORB-SLAM3 initialises the IMU 1 s after the first keyframe at the earliest. GetTimeFromIMUInit
// reads a pointer that is not set before that keyframe is mapped, so it is not called sooner.
constexpr double kLeastImuS = 1.0;
enum Kind : std::uint16_t { kSettings = 1, kFrames, kImu, kEnd, kReady, kPose };
enum State : std::uint32_t { kInitialising, kTracking, kLost };

int answers = -1;    // the standard output, before what ORB-SLAM3 prints

void Write(Kind kind, const std::vector<char>& body) {
  std::vector<char> bytes(12 + body.size());
  const std::uint32_t length = static_cast<std::uint32_t>(body.size());
  std::memcpy(bytes.data(), "LRSP", 4);
  std::memcpy(&bytes[4], &kVersion, 2);
  std::memcpy(&bytes[6], &kind, 2);
  std::memcpy(&bytes[8], &length, 4);
  std::copy(body.begin(), body.end(), bytes.begin() + 12);
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t n = write(answers, &bytes[done], bytes.size() - done);
    if (n <= 0) throw std::runtime_error("nobody reads the answers");
    done += static_cast<std::size_t>(n);
  }
}

// Returns false at the end of the input.
bool Read(void* to, std::size_t size) {
  std::size_t done = std::fread(to, 1, size, stdin);
  if (done != 0 && done != size) throw std::runtime_error("the input ends within a message");
  return done == size;
}

template <typename T>
T At(const std::vector<char>& body, std::size_t offset) {
  if (offset + sizeof(T) > body.size()) throw std::runtime_error("a message is too short");
  T value;
  std::memcpy(&value, &body[offset], sizeof(T));
  return value;
}

std::vector<ORB_SLAM3::IMU::Point> ImuOf(const std::vector<char>& body) {
  std::vector<ORB_SLAM3::IMU::Point> points;
  const std::uint32_t count = At<std::uint32_t>(body, 0);
  for (std::uint32_t k = 0; k < count; ++k) {
    const std::size_t at = 4 + 56 * static_cast<std::size_t>(k);
    double v[6];    // angular velocity, then specific force
    for (int i = 0; i < 6; ++i) v[i] = At<double>(body, at + 8 + 8 * i);
    points.emplace_back(v[3], v[4], v[5], v[0], v[1], v[2], 1e-9 * At<std::int64_t>(body, at));
  }
  return points;
}

// T_camera_world of ORB-SLAM3 to T_world_camera, of the left camera with an IMU, too.
template <typename SE3>
std::vector<char> PoseBody(std::int64_t stamp_ns, State state, const SE3& T_camera_world) {
  const auto T = T_camera_world.inverse();
  const auto q = T.unit_quaternion();
  const auto t = T.translation();
  const double numbers[7] = {t[0], t[1], t[2], q.x(), q.y(), q.z(), q.w()};
  std::vector<char> body(12 + sizeof(numbers));
  const std::uint32_t code = state;
  std::memcpy(&body[0], &stamp_ns, 8);
  std::memcpy(&body[8], &code, 4);
  std::memcpy(&body[12], numbers, sizeof(numbers));
  return body;
}

// Whether a frame was given no pose, in a map that is turned to gravity: of such a frame it is the
// identity, as of a new frame.
template <typename SE3>
bool IsUnset(const SE3& T_camera_world) {
  const auto t = T_camera_world.translation();
  return t[0] == 0.0f && t[1] == 0.0f && t[2] == 0.0f &&
         T_camera_world.unit_quaternion().w() == 1.0f;
}

int Run(const std::string& vocabulary, const std::string& settings, const std::string& name) {
  using ORB_SLAM3::System;
  const bool stereo = name != "mono", inertial = name == "stereo-inertial";
  if (stereo && !inertial && name != "stereo")
    throw std::runtime_error(name + " is not valid; valid are mono, stereo, stereo-inertial");
  System slam(vocabulary, settings,
              inertial ? System::IMU_STEREO : stereo ? System::STEREO : System::MONOCULAR, false);
  Write(kReady, {});
  std::vector<ORB_SLAM3::IMU::Point> imu;
  std::vector<char> body;
  char header[12];
  bool located = false;
  bool is_turned = false;   // the map, to gravity
  double first_s = -1.0;    // stamp of the first tracked frame
  while (Read(header, sizeof(header))) {
    std::uint16_t version, kind;
    std::uint32_t length;
    std::memcpy(&version, header + 4, 2);
    std::memcpy(&kind, header + 6, 2);
    std::memcpy(&length, header + 8, 4);
    if (std::memcmp(header, "LRSP", 4) != 0 || version != kVersion || length > kMostBytes)
      throw std::runtime_error("the input is not of this version of the protocol");
    body.resize(length);
    if (length != 0 && !Read(body.data(), length))
      throw std::runtime_error("the input ends within a message");
    if (kind == kEnd) break;
    if (kind == kImu) imu = ImuOf(body);
    if (kind != kFrames) continue;
    const std::int64_t stamp_ns = At<std::int64_t>(body, 0);
    const std::size_t width = At<std::uint32_t>(body, 8), height = At<std::uint32_t>(body, 12);
    const std::size_t count = At<std::uint32_t>(body, 16);
    if (count != (stereo ? 2u : 1u) || body.size() != 20 + count * width * height)
      throw std::runtime_error("the images do not fit the sensor " + name);
    const int rows = static_cast<int>(height), columns = static_cast<int>(width);
    const cv::Mat left(rows, columns, CV_8UC1, &body[20]);
    const double stamp_s = 1e-9 * static_cast<double>(stamp_ns);
    const auto pose = stereo
        ? slam.TrackStereo(left, cv::Mat(rows, columns, CV_8UC1, &body[20 + width * height]),
                           stamp_s, imu)
        : slam.TrackMonocular(left, stamp_s);
    imu.clear();
    bool ok = slam.GetTrackingState() == kTrackingOk;
    if (ok && first_s < 0.0) first_s = stamp_s;
    // Poses of a map that is not yet turned to gravity are of another frame than those after it.
    // It is turned beside the tracking, so the frame during which it was may be of either. The
    // frame at which a map is given up has no pose, and the state of the frame before.
    const bool was_turned = is_turned;
    if (inertial) {
      is_turned = ok && !IsUnset(pose) && stamp_s - first_s > kLeastImuS &&
                  slam.GetTimeFromIMUInit() > 0.0;
      ok = was_turned && is_turned;
    }
    located |= ok;
    Write(kPose, PoseBody(stamp_ns, ok ? kTracking : located ? kLost : kInitialising, pose));
  }
  slam.Shutdown();
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: " << argv[0] << " VOCABULARY SETTINGS mono|stereo|stereo-inertial\n";
    return 2;
  }
  // What ORB-SLAM3 prints must not get between the answers.
  answers = dup(STDOUT_FILENO);
  dup2(STDERR_FILENO, STDOUT_FILENO);
  try {
    return Run(argv[1], argv[2], argv[3]);
  } catch (const std::exception& error) {
    std::cerr << argv[0] << ": " << error.what() << "\n";
    return 1;
  }
}
