// Times ViSP's features on the work of features.py: s, L and e of one view, by our names of them.
// Usage: visp_features PGM NEAR.pgm Z COUNT   ->   a line each: name and the median in microseconds
//
//   g++ -O3 -march=native visp_features.cpp -o visp_features -I/usr/include/visp3 \
//     -lvisp_core -lvisp_visual_features -lvisp_vision -lvisp_vs
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpCircle.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpLine.h>
#include <visp3/core/vpMomentAlpha.h>
#include <visp3/core/vpMomentCommon.h>
#include <visp3/core/vpMomentObject.h>
#include <visp3/core/vpPoint.h>
#include <visp3/vision/vpPose.h>
#include <visp3/visual_features/vpFeatureBuilder.h>
#include <visp3/visual_features/vpFeatureDepth.h>
#include <visp3/visual_features/vpFeatureEllipse.h>
#include <visp3/visual_features/vpFeatureLine.h>
#include <visp3/visual_features/vpFeatureLuminance.h>
#include <visp3/visual_features/vpFeatureMomentCommon.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/visual_features/vpFeaturePoint3D.h>
#include <visp3/visual_features/vpFeaturePointPolar.h>
#include <visp3/visual_features/vpFeatureSegment.h>
#include <visp3/visual_features/vpFeatureThetaU.h>
#include <visp3/visual_features/vpFeatureTranslation.h>
#include <visp3/visual_features/vpFeatureVanishingPoint.h>

static int count = 200;

// Processor time of one call, microseconds: the median of `count` batches.
static void timed(const std::string &name, const std::function<void()> &work, int batch = 20)
{
  std::vector<double> taken;
  for (int k = -count / 4; k < count; ++k) { // the first ones warm up
    timespec begin, end;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
    for (int i = 0; i < batch; ++i) {
      work();
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
    if (k >= 0) {
      taken.push_back(((end.tv_sec - begin.tv_sec) * 1e9 + (end.tv_nsec - begin.tv_nsec)) * 1e-3 / batch);
    }
  }
  std::nth_element(taken.begin(), taken.begin() + taken.size() / 2, taken.end());
  std::cout << name << " " << taken[taken.size() / 2] << std::endl;
}

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

// s, L and e of one feature each, made from what `build` sees.
template <class Feature> static void features(const std::string &name, std::vector<Feature> &desired,
                                              const std::function<void(std::vector<Feature> &)> &build)
{
  std::vector<Feature> now(desired.size());
  timed(name, [&]() {
    build(now);
    for (size_t i = 0; i < now.size(); ++i) {
      const vpMatrix L = now[i].interaction();
      const vpColVector e = now[i].error(desired[i]);
      if (std::isnan(L[0][0] + e[0])) {
        std::abort();
      }
    }
  });
}

int main(int argc, char **argv)
{
  if (argc != 5) {
    return 1;
  }
  const vpImage<unsigned char> goal = readPgm(argv[1]), near = readPgm(argv[2]);
  const double depth = std::atof(argv[3]);
  count = std::atoi(argv[4]);
  const double corners[4][2] = {{-0.11, -0.05}, {0.09, -0.08}, {0.13, 0.06}, {-0.07, 0.04}};
  const vpHomogeneousMatrix cdMo(0.02, -0.03, 0.7, 0.15, -0.2, 0.1), cMo(0.05, 0.04, 0.9, 0.2, 0.3, 0.5);
  std::vector<vpPoint> points(4), there(4);
  for (int i = 0; i < 4; ++i) {
    points[i].setWorldCoordinates(corners[i][0], corners[i][1], 0.0);
    there[i] = points[i];
    points[i].track(cMo);
    there[i].track(cdMo);
  }

  std::vector<vpFeaturePoint> point(4);
  std::vector<vpFeaturePointPolar> polar(4);
  std::vector<vpFeaturePoint3D> place(4);
  std::vector<vpFeatureDepth> far(1);
  std::vector<vpFeatureSegment> segment(4);
  for (int i = 0; i < 4; ++i) {
    vpFeatureBuilder::create(point[i], there[i]);
    vpFeatureBuilder::create(polar[i], there[i]);
    place[i].buildFrom(there[i]);
    vpPoint one = there[i], other = there[(i + 1) % 4];
    vpFeatureBuilder::create(segment[i], one, other);
  }
  far[0].buildFrom(0.0, 0.0, 1.0, 0.0);
  features<vpFeaturePoint>("numbered_points", point, [&](std::vector<vpFeaturePoint> &now) {
    for (int i = 0; i < 4; ++i) {
      now[i].buildFrom(points[i].get_x(), points[i].get_y(), points[i].get_Z());
    }
  });
  features<vpFeaturePointPolar>("polar_points", polar, [&](std::vector<vpFeaturePointPolar> &now) {
    for (int i = 0; i < 4; ++i) {
      vpFeatureBuilder::create(now[i], points[i]);
    }
  });
  features<vpFeaturePoint3D>("points_3d", place, [&](std::vector<vpFeaturePoint3D> &now) {
    for (int i = 0; i < 4; ++i) {
      now[i].buildFrom(points[i]);
    }
  });
  features<vpFeatureDepth>("depth", far, [&](std::vector<vpFeatureDepth> &now) {
    now[0].buildFrom(points[0].get_x(), points[0].get_y(), 0.9, std::log(0.9 / 0.7));
  });
  features<vpFeatureSegment>("segments", segment, [&](std::vector<vpFeatureSegment> &now) {
    for (int i = 0; i < 4; ++i) {
      vpFeatureBuilder::create(now[i], points[i], points[(i + 1) % 4]);
    }
  });

  std::vector<vpLine> sides(4);
  std::vector<vpFeatureLine> line(4);
  for (int i = 0; i < 4; ++i) { // a line is where two planes meet: the target's, and one that holds the side
    const double *a = corners[i], *b = corners[(i + 1) % 4];
    sides[i].setWorldCoordinates(0, 0, 1, 0, b[1] - a[1], a[0] - b[0], 0, a[1] * b[0] - a[0] * b[1]);
    sides[i].track(cdMo);
    vpFeatureBuilder::create(line[i], sides[i]);
    sides[i].track(cMo);
  }
  features<vpFeatureLine>("lines", line, [&](std::vector<vpFeatureLine> &now) {
    for (int i = 0; i < 4; ++i) {
      vpFeatureBuilder::create(now[i], sides[i]);
    }
  });

  std::vector<vpFeatureVanishingPoint> vanishing(1);
  vpFeatureBuilder::create(vanishing[0], line[0], line[2]);
  features<vpFeatureVanishingPoint>("vanishing_points", vanishing,
                                    [&](std::vector<vpFeatureVanishingPoint> &now) {
                                      vpFeatureBuilder::create(now[0], line[1], line[3]);
                                    });

  vpCircle circle(0, 0, 1, 0, 0, 0, 0.1);
  std::vector<vpFeatureEllipse> ellipse(1);
  circle.track(cdMo);
  vpFeatureBuilder::create(ellipse[0], circle);
  circle.track(cMo);
  features<vpFeatureEllipse>("ellipse", ellipse,
                             [&](std::vector<vpFeatureEllipse> &now) { vpFeatureBuilder::create(now[0], circle); });

  // Pose from the four points, then theta u and the translation: what position-based servoing measures.
  vpFeatureThetaU turn(vpFeatureThetaU::cdRc), noTurn(vpFeatureThetaU::cdRc);
  vpFeatureTranslation way(vpFeatureTranslation::cdMc), noWay(vpFeatureTranslation::cdMc);
  timed("pose", [&]() {
    vpPose pose;
    for (vpPoint &one : points) {
      pose.addPoint(one);
    }
    vpHomogeneousMatrix found;
    pose.computePose(vpPose::DEMENTHON_LOWE, found);
    const vpHomogeneousMatrix cdMc = cdMo * found.inverse();
    turn.buildFrom(cdMc);
    way.buildFrom(cdMc);
    const double sum = turn.interaction()[0][3] + way.interaction()[0][0] + turn.error(noTurn)[0] + way.error(noWay)[0];
    if (std::isnan(sum)) {
      std::abort();
    }
  });

  // All moment features that vpFeatureMomentCommon holds, of the polygon: ViSP's own example computes them together.
  std::vector<vpPoint> polygon(points.begin(), points.end());
  polygon.push_back(points[0]);
  vpMomentObject object(6);
  object.setType(vpMomentObject::DENSE_POLYGON);
  object.fromVector(polygon);
  const double area = object.get(0, 0);
  const std::vector<double> third = vpMomentCommon::getMu3(object);
  const double alpha = vpMomentCommon::getAlpha(object);
  timed("moments_all", [&]() {
    object.fromVector(polygon);
    vpMomentCommon moments(area, third, alpha, 0.7);
    vpFeatureMomentCommon rows(moments);
    moments.updateAll(object);
    rows.updateAll(0.1, 0.2, 1.1);
  }, 5);

  vpCameraParameters camera(300, 300, 159.5, 119.5);
  vpFeatureLuminance desired, now;
  for (vpFeatureLuminance *one : {&desired, &now}) {
    one->init(goal.getHeight(), goal.getWidth(), depth);
    one->setCameraParameters(camera);
  }
  vpImage<unsigned char> copy = goal;
  desired.buildFrom(copy);
  vpImage<unsigned char> seen = near;
  vpMatrix L;
  vpColVector e;
  timed("luminance, s L e", [&]() {
    now.buildFrom(seen);
    now.interaction(L);
    now.error(desired, e);
  }, 1);
  timed("luminance", [&]() { // with the normal equations that Gauss-Newton solves: what ours answers
    now.buildFrom(seen);
    now.interaction(L);
    now.error(desired, e);
    const vpMatrix H = L.AtA();
    const vpColVector g = L.t() * e;
    if (std::isnan(H[0][0] + g[0])) {
      std::abort();
    }
  }, 1);
  return 0;
}
