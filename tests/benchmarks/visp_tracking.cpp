// ViSP's generic model-based tracker on the sequences of model_tracking.py, by its tutorial's settings.
// Usage: visp_tracking FOLDER COUNT edges|klt fx fy cx cy mx my mz scanline axis
//   FOLDER has pictures.raw (COUNT pictures of 640 x 480 bytes), poses.txt (COUNT rows of the 16
//   numbers of camera_T_solid) and model.cao; mx my mz is the solid's middle. Answers a line a picture:
//   milliseconds of processor, and the 16 numbers found. After a picture in which the middle is more
//   than 5 mm or the attitude (with axis 1: the z axis alone) more than 3 degrees off, it is started
//   from the true pose again.
//
//   g++ -O3 -march=native visp_tracking.cpp -o visp_tracking \
//     -lvisp_core -lvisp_mbt -lvisp_me -lvisp_klt -lvisp_io -lvisp_tt -lvisp_vision $(pkg-config --cflags --libs opencv4)
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

#include <visp3/core/vpColVector.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpThetaUVector.h>
#include <visp3/mbt/vpMbGenericTracker.h>

static double now()
{
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return 1e3 * t.tv_sec + 1e-6 * t.tv_nsec;
}

static bool lost(const vpHomogeneousMatrix &found, const vpHomogeneousMatrix &truth,
                 const vpColVector &middle, bool axis)
{
  vpColVector a = found * middle, b = truth * middle;
  double away = std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                          (a[2] - b[2]) * (a[2] - b[2]));
  double angle;
  if (axis) {
    double cosine = found[0][2] * truth[0][2] + found[1][2] * truth[1][2] + found[2][2] * truth[2][2];
    angle = std::acos(std::min(1.0, std::max(-1.0, cosine)));
  } else {
    vpRotationMatrix turned = found.getRotationMatrix().t() * truth.getRotationMatrix();
    vpThetaUVector u(turned);
    angle = std::sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
  }
  return !(away <= 5e-3) || !(angle <= 3.0 * M_PI / 180.0);
}

int main(int count_of, char **given)
{
  if (count_of != 13) {
    std::cerr << "usage: visp_tracking FOLDER COUNT edges|klt fx fy cx cy mx my mz scanline axis\n";
    return 2;
  }
  const std::string folder = given[1], kind = given[3];
  const int count = std::atoi(given[2]);
  double n[7];
  for (int i = 0; i < 7; i++)
    n[i] = std::atof(given[4 + i]);
  vpColVector middle(4);
  middle[0] = n[4], middle[1] = n[5], middle[2] = n[6], middle[3] = 1.0;
  const bool scanline = std::atoi(given[11]), axis = std::atoi(given[12]);

  int type = vpMbGenericTracker::EDGE_TRACKER;
  if (kind == "klt")
    type |= vpMbGenericTracker::KLT_TRACKER;
  vpMbGenericTracker tracker(1, type);
  vpMe me;
  me.setMaskSize(5);
  me.setMaskNumber(180);
  me.setRange(8);
  me.setThreshold(10000);
  me.setMu1(0.5);
  me.setMu2(0.5);
  me.setSampleStep(4);
  tracker.setMovingEdge(me);
  if (kind == "klt") {
    vpKltOpencv klt;
    tracker.setKltMaskBorder(5);
    klt.setMaxFeatures(300);
    klt.setWindowSize(5);
    klt.setQuality(0.015);
    klt.setMinDistance(8);
    klt.setHarrisFreeParameter(0.01);
    klt.setBlockSize(3);
    klt.setPyramidLevels(3);
    tracker.setKltOpencv(klt);
  }
  vpCameraParameters camera;
  camera.initPersProjWithoutDistortion(n[0], n[1], n[2], n[3]);
  tracker.setCameraParameters(camera);
  tracker.setAngleAppear(vpMath::rad(70));
  tracker.setAngleDisappear(vpMath::rad(80));
  tracker.setNearClippingDistance(0.1);
  tracker.setFarClippingDistance(100.0);
  tracker.setClipping(tracker.getClipping() | vpMbtPolygon::FOV_CLIPPING);
  tracker.setDisplayFeatures(false);
  if (scanline)
    tracker.setScanLineVisibilityTest(true);
  tracker.loadModel(folder + "/model.cao");

  std::ifstream pictures(folder + "/pictures.raw", std::ios::binary), poses(folder + "/poses.txt");
  vpImage<unsigned char> image(480, 640);
  bool fresh = true;
  for (int i = 0; i < count; i++) {
    pictures.read(reinterpret_cast<char *>(image.bitmap), 640 * 480);
    vpHomogeneousMatrix truth, found;
    for (int r = 0; r < 4; r++)
      for (int c = 0; c < 4; c++)
        poses >> truth[r][c];
    double begin = now();
    try {
      if (fresh)
        tracker.initFromPose(image, truth);
      tracker.track(image);
      tracker.getPose(found);
      fresh = false;
    } catch (const vpException &fault) {
      std::cerr << i << ": " << fault.what() << '\n';
      found.eye();
    }
    double took = now() - begin;
    std::cout << took;
    for (int r = 0; r < 4; r++)
      for (int c = 0; c < 4; c++)
        std::cout << ' ' << found[r][c];
    std::cout << '\n';
    if (lost(found, truth, middle, axis))
      fresh = true;
  }
  return 0;
}
