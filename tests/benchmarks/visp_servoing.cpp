// Servos a free camera to a square with ViSP, for peers.py: exact corners, or images with four dots.
// Usage: visp_servoing exact|images COUNT   ->   ms of processor time per image, and the final error
//
//   g++ -O3 visp_servoing.cpp -o visp_servoing $(pkg-config --cflags --libs visp)
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <iostream>
#include <string>
#include <vector>

#include <visp3/blob/vpDot2.h>
#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpExponentialMap.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpMeterPixelConversion.h>
#include <visp3/core/vpPoint.h>
#include <visp3/robot/vpImageSimulator.h>
#include <visp3/visual_features/vpFeatureBuilder.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/vs/vpServo.h>

static const double HALF = 0.1, DEPTH = 0.5, PERIOD = 1.0 / 30.0, GAIN = 1.5;

// White square with four black dots, whose centres are the corners of a square of 2 HALF.
static vpImage<unsigned char> drawDots(unsigned int size)
{
  vpImage<unsigned char> image(size, size, 255);
  for (int corner = 0; corner < 4; ++corner) {
    const double x = size * ((corner == 1 || corner == 2) ? 0.75 : 0.25);
    const double y = size * (corner >= 2 ? 0.75 : 0.25);
    for (unsigned int i = 0; i < size; ++i) {
      for (unsigned int j = 0; j < size; ++j) {
        if (std::hypot(i + 0.5 - y, j + 0.5 - x) < 0.08 * size) {
          image[i][j] = 0;
        }
      }
    }
  }
  return image;
}

static double now()
{
  timespec time;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return time.tv_sec + time.tv_nsec * 1e-9;
}

int main(int argc, char **argv)
{
  if (argc != 3) {
    std::cerr << "usage: visp_servoing exact|images COUNT" << std::endl;
    return 2;
  }
  const bool images = std::string(argv[1]) == "images";
  const int count = std::atoi(argv[2]);
  const vpCameraParameters camera(250.0, 250.0, 159.5, 119.5);
  const double x[] = {-HALF, HALF, HALF, -HALF}, y[] = {-HALF, -HALF, HALF, HALF};
  vpHomogeneousMatrix cdMo(0.0, 0.0, DEPTH, 0.0, 0.0, 0.0);
  vpHomogeneousMatrix cMo(0.03, -0.02, 0.62, 0.05, -0.05, 0.2);

  vpServo task;
  task.setServo(vpServo::EYEINHAND_CAMERA);
  task.setInteractionMatrixType(vpServo::DESIRED, vpServo::PSEUDO_INVERSE);
  task.setLambda(GAIN);
  std::vector<vpPoint> points;
  std::vector<vpFeaturePoint> s(4), desired(4);
  std::vector<vpDot2> dots(4);
  for (int k = 0; k < 4; ++k) {
    points.emplace_back(x[k], y[k], 0.0);
    points[k].track(cdMo);
    vpFeatureBuilder::create(desired[k], points[k]);
    task.addFeature(s[k], desired[k]);
  }
  vpImage<unsigned char> image(240, 320, 200);
  vpImageSimulator simulator;
  simulator.setInterpolationType(vpImageSimulator::BILINEAR_INTERPOLATION);
  if (images) {
    std::vector<vpColVector> corners(4, vpColVector(3));
    for (int k = 0; k < 4; ++k) { // the dots are half as far apart as the corners of their picture
      corners[k][0] = 2.0 * x[k];
      corners[k][1] = 2.0 * y[k];
    }
    simulator.init(drawDots(400), corners.data());
  }
  double start = 0.0;
  for (int n = -20; n < count; ++n) { // the first ones warm up
    if (n == 0) {
      start = now();
    }
    if (images) {
      image = 200;
      simulator.setCleanPreviousImage(false);
      simulator.setCameraPosition(cMo);
      simulator.getImage(image, camera);
    }
    for (int k = 0; k < 4; ++k) {
      points[k].track(cMo);
      if (!images) {
        vpFeatureBuilder::create(s[k], points[k]);
        continue;
      }
      if (n == -20) {
        vpImagePoint place;
        vpMeterPixelConversion::convertPoint(camera, points[k].get_x(), points[k].get_y(), place);
        dots[k].initTracking(image, place);
      } else {
        dots[k].track(image);
      }
      vpFeatureBuilder::create(s[k], camera, dots[k]);
      s[k].set_Z(DEPTH);
    }
    const vpColVector v = task.computeControlLaw();
    cMo = vpExponentialMap::direct(v, PERIOD).inverse() * cMo;
  }
  std::cout << 1e3 * (now() - start) / count << " " << std::sqrt(task.getError().sumSquare())
            << std::endl;
  task.kill();
  return 0;
}
