// Times ViSP on the same work as moments.py: grey picture in, order-6 moments, all feature updates.
// Usage: visp_moments PGM px py u0 v0 repeats   ->   one line: median ms of fromImage and of the rest
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpMomentAlpha.h>
#include <visp3/core/vpMomentArea.h>
#include <visp3/core/vpMomentBasic.h>
#include <visp3/core/vpMomentCommon.h>
#include <visp3/core/vpMomentObject.h>
#include <visp3/visual_features/vpFeatureMomentCommon.h>

#include <fstream>
#include <string>

static vpImage<unsigned char> readPgm(const char *path)
{
  std::ifstream file(path, std::ios::binary);
  std::string magic;
  unsigned int width, height, level;
  file >> magic >> width >> height >> level;
  file.get();
  vpImage<unsigned char> image(height, width);
  file.read(reinterpret_cast<char *>(image.bitmap), static_cast<std::streamsize>(width) * height);
  return image;
}

static double median(std::vector<double> times)
{
  std::nth_element(times.begin(), times.begin() + times.size() / 2, times.end());
  return times[times.size() / 2];
}

int main(int argc, char **argv)
{
  if (argc != 7) {
    return 1;
  }
  const vpImage<unsigned char> image = readPgm(argv[1]);
  const vpCameraParameters camera(std::atof(argv[2]), std::atof(argv[3]), std::atof(argv[4]), std::atof(argv[5]));
  const int repeats = std::atoi(argv[6]);
  using Clock = std::chrono::steady_clock;
  std::vector<double> reading, features;
  vpMomentObject object(6);
  object.setType(vpMomentObject::DENSE_FULL_OBJECT);
  object.fromImage(image, 128, camera);
  const double area = object.get(0, 0);
  const std::vector<double> third = vpMomentCommon::getMu3(object);
  const double alpha = vpMomentCommon::getAlpha(object);
  for (int k = -repeats; k < repeats; ++k) { // the first half warms up
    const auto start = Clock::now();
    object.fromImage(image, 128, camera);
    const auto middle = Clock::now();
    vpMomentCommon moments(area, third, alpha, 0.5);
    vpFeatureMomentCommon rows(moments);
    moments.updateAll(object);
    rows.updateAll(0.1, 0.2, 2.0);
    const auto end = Clock::now();
    if (k >= 0) {
      reading.push_back(std::chrono::duration<double, std::milli>(middle - start).count());
      features.push_back(std::chrono::duration<double, std::milli>(end - middle).count());
    }
  }
  std::cout << median(reading) << " " << median(features) << std::endl;
  return 0;
}
