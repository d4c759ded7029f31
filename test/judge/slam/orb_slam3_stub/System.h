// A stand-in for the public interface of ORB-SLAM3 1.0, with which the adapter is compiled in tests.
// It tracks nothing: the camera is as far along x as there were frames. With an IMU it gives its map
// up at the fifth frame, which has no pose. See test_protocol.py.
#pragma once
#include <array>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#define CV_8UC1 0

namespace cv {
struct Mat {
  int rows, cols, type;
  unsigned char* data;
  Mat(int r, int c, int t, void* d) : rows(r), cols(c), type(t),
                                      data(static_cast<unsigned char*>(d)) {}
};
}  // namespace cv

namespace Sophus {
struct Quaternion {
  float x() const { return 0.0f; }
  float y() const { return 0.0f; }
  float z() const { return 0.0f; }
  float w() const { return 1.0f; }
};
struct SE3f {
  std::array<float, 3> t;
  SE3f inverse() const { return SE3f{{-t[0], -t[1], -t[2]}}; }
  std::array<float, 3> translation() const { return t; }
  Quaternion unit_quaternion() const { return {}; }
};
}  // namespace Sophus

namespace ORB_SLAM3 {
namespace IMU {
struct Point {
  double force_x, rate_x, stamp_s;
  Point(float ax, float, float, float wx, float, float, double t)
      : force_x(ax), rate_x(wx), stamp_s(t) {}
};
}  // namespace IMU

class System {
 public:
  enum eSensor { MONOCULAR, STEREO, RGBD, IMU_MONOCULAR, IMU_STEREO };
  System(const std::string&, const std::string& settings, eSensor, bool) {
    std::printf("reads %s\n", settings.c_str());
  }
  // x: frames so far; y: the sum of the last pixels; z: stamp of the last IMU sample.
  Sophus::SE3f TrackStereo(const cv::Mat& left, const cv::Mat& right, double,
                           const std::vector<IMU::Point>& imu = {}) {
    return Next(Last(left) + Last(right), imu);
  }
  Sophus::SE3f TrackMonocular(const cv::Mat& left, double) { return Next(Last(left), {}); }
  int GetTrackingState() const { return frames_ == 1 ? 1 : 2; }
  // 0 before the IMU is initialised, at the third frame. Before a keyframe it crashes, as theirs.
  double GetTimeFromIMUInit() const {
    if (frames_ < 3) std::abort();
    return 0.1 * (frames_ - 2);
  }
  void Shutdown() {}

 private:
  int frames_ = 0;
  static float Last(const cv::Mat& m) { return m.data[m.rows * m.cols - 1]; }
  Sophus::SE3f Next(float y, const std::vector<IMU::Point>& imu) {
    ++frames_;
    if (!imu.empty() && frames_ == 5) return {{0.0f, 0.0f, 0.0f}};
    return {{-float(frames_), -y, imu.empty() ? 0.0f : -float(imu.back().stamp_s)}};
  }
};
}  // namespace ORB_SLAM3
