// Python module _kernel: checks what comes in, releases the interpreter lock, calls the kernel.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "icgn.hpp"
#include "loops.hpp"
#include "pose_fit.hpp"
#include "reference.hpp"
#include "seed_maps.hpp"
#include "spline_image.hpp"
#include "threads.hpp"

namespace py = pybind11;

namespace rgbd_dic {
namespace {

constexpr std::ptrdiff_t kSeedBlock = 256;  // subsets: below, a thread costs more than it saves

std::string describe(const py::array& array) {
  return py::str(array.dtype()).cast<std::string>() + " of shape " +
         py::str(array.attr("shape")).cast<std::string>();
}

// Checks dtype, contiguity and shape; -1 in `shape` stands for any length. Nothing is ever converted.
template <class Value>
const Value* checked(const py::array& array, const char* name, const std::vector<py::ssize_t>& shape,
                     const char* expected) {
  bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
  for (std::size_t k = 0; fits && k < shape.size(); ++k)
    fits = shape[k] < 0 || array.shape(static_cast<py::ssize_t>(k)) == shape[k];
  if (!py::isinstance<py::array_t<Value>>(array))
    throw py::type_error(std::string(name) + ": expected " + expected + ", got " + describe(array));
  if (!fits) throw py::value_error(std::string(name) + ": expected " + expected + ", got " + describe(array));
  if (!(array.flags() & py::array::c_style))
    throw py::value_error(std::string(name) + ": must be C-contiguous; pass numpy.ascontiguousarray(" + name +
                          ")");
  if (!(array.flags() & py::detail::npy_api::NPY_ARRAY_ALIGNED_))
    throw py::value_error(std::string(name) + ": is not aligned in memory; pass a copy");
  return static_cast<const Value*>(array.data());
}

constexpr double kInfinity = std::numeric_limits<double>::infinity();

template <class Value>
Value checked(Value value, const char* name, Value low, Value high) {
  if (value >= low && value <= high) return value;  // NaN is not
  std::ostringstream message;
  message << name << " = " << value << ": must be " << low << " to " << high;
  throw py::value_error(message.str());
}

int checked_threads(int threads) { return resolve_threads(checked(threads, "threads", 0, kMaxThreads)); }

Image to_image(const py::array& image) {
  constexpr const char* kExpected = "uint8 or float32 of shape (rows, cols)";
  if (py::isinstance<py::array_t<std::uint8_t>>(image)) {
    const auto* pixels = checked<std::uint8_t>(image, "image", {-1, -1}, kExpected);
    return Image(std::vector<std::uint8_t>(pixels, pixels + image.size()), image.shape(0), image.shape(1));
  }
  const auto* pixels = checked<float>(image, "image", {-1, -1}, kExpected);
  const py::ssize_t cols = image.shape(1);
  for (py::ssize_t i = 0; i < image.size(); ++i)
    if (!std::isfinite(pixels[i]))
      throw py::value_error("image: pixel (" + std::to_string(i % cols) + ", " + std::to_string(i / cols) +
                            ") is not a finite number");
  return Image(std::vector<float>(pixels, pixels + image.size()), image.shape(0), cols);
}

// The loops that what is made from now on will use.
const Loops*& chosen_loops() {
  static const Loops* chosen = available_loops().front();
  return chosen;
}

std::vector<std::string> instruction_sets() {
  std::vector<std::string> names;
  for (const Loops* loops : available_loops()) names.emplace_back(loops->name);
  return names;
}

void use_instruction_set(const std::string& name) {
  std::string known;
  for (const Loops* loops : available_loops()) {
    if (name == loops->name) {
      chosen_loops() = loops;
      return;
    }
    known += (known.empty() ? "" : ", ") + std::string(loops->name);
  }
  throw py::value_error("instruction set '" + name + "': this processor has " + known);
}

std::unique_ptr<Reference> make_reference(const py::array& image, const py::array& centres, int subset_size,
                                          int degree, int order, double smoothing, int threads) {
  const Image pixels = to_image(image);
  const auto* xy = checked<double>(centres, "centres", {-1, 2}, "float64 of shape (N, 2)");
  const py::ssize_t count = centres.shape(0);
  const Loops& loops = *chosen_loops();
  threads = checked_threads(threads);
  const py::gil_scoped_release unlocked;
  return std::make_unique<Reference>(loops, pixels, xy, count,
                                     SubsetModel{subset_size, degree, order, smoothing}, threads);
}

py::array_t<std::uint8_t> reference_status(const Reference& reference, double min_contrast) {
  py::array_t<std::uint8_t> status(reference.size());
  for (std::ptrdiff_t i = 0; i < reference.size(); ++i)
    status.mutable_at(i) = static_cast<std::uint8_t>(status_in_reference(reference, i, min_contrast));
  return status;
}

py::array_t<float> reference_sigma(const Reference& reference, double noise) {
  checked(noise, "noise", 0.0, kInfinity);
  py::array_t<float> sigma({reference.size(), std::ptrdiff_t{2}});
  for (std::ptrdiff_t i = 0; i < reference.size(); ++i) {
    const bool usable = reference[i].state == Subset::State::kUsable;
    const std::array<double, 2> of_point = expected_sigma(reference[i], noise);
    for (int axis = 0; axis < 2; ++axis)
      sigma.mutable_at(i, axis) =
          usable ? static_cast<float>(of_point[axis]) : std::numeric_limits<float>::quiet_NaN();
  }
  return sigma;
}

std::unique_ptr<SplineImage> make_target(const py::array& image, int degree) {
  return std::make_unique<SplineImage>(*chosen_loops(), to_image(image), degree);
}

py::array_t<double> sample(SplineImage& target, const py::array& points) {
  const auto* xy = checked<double>(points, "points", {-1, 2}, "float64 of shape (M, 2)");
  const SplineBox coefficients = target.covering(target.whole(), 1);
  const Loops& loops = target.loops();
  const Layout one = {0, 1};
  FloatBuffer value(loops.width);
  const auto function = target.degree() == 3 ? loops.sample_cubic : loops.sample_quintic;
  const double right = static_cast<double>(target.cols() - 1),
               bottom = static_cast<double>(target.rows() - 1);
  py::array_t<double> values(points.shape(0));
  double* out = values.mutable_data();
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    const double x = xy[2 * i], y = xy[2 * i + 1], x0 = std::floor(x), y0 = std::floor(y);
    out[i] = std::numeric_limits<double>::quiet_NaN();
    if (!(x >= 0.0 && x <= right && y >= 0.0 && y <= bottom)) continue;
    const LocalWarp warp = {{static_cast<float>(x - x0)}, {static_cast<float>(y - y0)}};
    const auto around = coefficients.around(static_cast<std::ptrdiff_t>(x0), static_cast<std::ptrdiff_t>(y0));
    if (function(one, around, warp, value.data())) out[i] = value.data()[0];
  }
  return values;
}

const std::int32_t* checked_indices(const std::optional<py::array>& indices, py::ssize_t subsets) {
  if (!indices) return nullptr;
  const auto* values = checked<std::int32_t>(*indices, "indices", {-1}, "int32 of shape (M,)");
  for (py::ssize_t i = 0; i < indices->size(); ++i)
    if (values[i] < 0 || values[i] >= subsets)
      throw py::index_error("indices[" + std::to_string(i) + "] = " + std::to_string(values[i]) +
                            ": there are " + std::to_string(subsets) + " subsets");
  return values;
}

py::array_t<double> seed_maps(const py::array& stencil, const py::array& homography, const py::array& lens,
                              double reach, const std::optional<py::array>& offsets,
                              const std::optional<py::array>& indices, int threads) {
  threads = checked_threads(threads);
  const auto* points = checked<double>(stencil, "stencil", {9, -1, 2}, "float64 of shape (9, N, 2)");
  const auto* h = checked<double>(homography, "homography", {3, 3}, "float64 of shape (3, 3)");
  const auto* of_lens = checked<double>(lens, "lens", {6}, "float64 of shape (6,)");
  checked(reach, "reach", 1e-3, 1e6);
  const py::ssize_t subsets = stencil.shape(1);
  const double* away =
      offsets ? checked<double>(*offsets, "offsets", {subsets, 2}, "float64 of shape (N, 2), as the stencil")
              : nullptr;
  const std::int32_t* selected = checked_indices(indices, subsets);
  const py::ssize_t count = indices ? indices->size() : subsets;
  py::array_t<double> maps({count, py::ssize_t{2}, py::ssize_t{6}});
  auto* out = reinterpret_cast<Quadratic*>(maps.mutable_data());
  const Lens raw = {of_lens[0], of_lens[1], of_lens[2], of_lens[3], of_lens[4], of_lens[5]};
  const auto make = [&](int, std::ptrdiff_t begin, std::ptrdiff_t end) {
    for (std::ptrdiff_t i = begin; i < end; ++i) {
      const std::ptrdiff_t k = selected ? selected[i] : i;
      out[i] = seed_map(points + 2 * k, 2 * subsets, h, raw, reach);
      for (int axis = 0; away && axis < 2; ++axis) out[i][axis][0] += away[2 * k + axis];
    }
  };
  {
    const py::gil_scoped_release unlocked;
    parallel_blocks(count, kSeedBlock, threads, make);
  }
  return maps;
}

py::object fit_pose(const py::array& points, const py::array& target, const py::array& sigma,
                    const py::array& rotation, const py::array& translation,
                    const std::array<double, 4>& lens, double robust_sigmas, double median_length,
                    double converged_px, int max_iterations, int misfit_iterations) {
  constexpr const char* kPairs = "float64 of shape (M, 2), as many as the points";
  const auto* xyz = checked<double>(points, "points", {-1, 3}, "float64 of shape (M, 3)");
  const py::ssize_t count = points.shape(0);
  const auto* seen = checked<double>(target, "target", {count, 2}, kPairs);
  const auto* sure = checked<double>(sigma, "sigma", {count, 2}, kPairs);
  const auto* R = checked<double>(rotation, "rotation", {3, 3}, "float64 of shape (3, 3)");
  const auto* t = checked<double>(translation, "translation", {3}, "float64 of shape (3,)");
  if (count == 0) return py::none();
  Pose start;
  std::copy_n(R, 9, start.R.begin());
  std::copy_n(t, 3, start.t.begin());
  PoseFit fit({count, xyz, seen, sure, lens[0], lens[1], lens[2], lens[3]},
              {robust_sigmas, median_length, converged_px, max_iterations, misfit_iterations}, start);
  bool converged;
  {
    const py::gil_scoped_release unlocked;
    converged = fit.run();
  }
  if (!converged) return py::none();
  py::array_t<double> turn({3, 3}), shift(3), jacobian({py::ssize_t{6}, count, py::ssize_t{2}}),
      weights({count, py::ssize_t{2}});
  std::copy_n(fit.pose().R.begin(), 9, turn.mutable_data());
  std::copy_n(fit.pose().t.begin(), 3, shift.mutable_data());
  fit.copy(jacobian.mutable_data(), weights.mutable_data());
  return py::make_tuple(turn, shift, jacobian, weights, fit.misfit_px());
}

py::tuple correlate(const Reference& reference, SplineImage& target, const py::array& seeds,
                    const std::optional<py::array>& indices, int max_iterations, double tolerance_px,
                    double min_zncc, double min_contrast, double max_shift_px, double max_misfit_px,
                    int threads) {
  if (&reference.loops() != &target.loops())
    throw py::value_error("the reference and the target were made for different instruction sets");
  if (reference.model().degree != target.degree())
    throw py::value_error("the reference was made with B-spline degree " +
                          std::to_string(reference.model().degree) + ", the target with " +
                          std::to_string(target.degree()));
  const Limits limits{checked(max_iterations, "max_iterations", 1, 255),
                      checked(tolerance_px, "tolerance_px", 1e-9, 1.0),
                      checked(min_zncc, "min_zncc", -1.0, 1.0),
                      checked(min_contrast, "min_contrast", 0.0, kInfinity),
                      checked(max_shift_px, "max_shift_px", 0.0, 1e6),
                      checked(max_misfit_px, "max_misfit_px", 0.0, kInfinity)};
  threads = checked_threads(threads);
  const std::int32_t* selected = checked_indices(indices, reference.size());
  const py::ssize_t count = indices ? indices->size() : reference.size();
  const std::string expected =
      "float64 of shape (" + std::to_string(reference.size()) + ", 2, 6), one seed a subset";
  static_assert(sizeof(Quadratic) == 12 * sizeof(double), "a seed is twelve numbers in a row");
  const auto* maps = reinterpret_cast<const Quadratic*>(
      checked<double>(seeds, "seeds", {reference.size(), 2, 6}, expected.c_str()));

  py::array_t<double> x(count), y(count);
  py::array_t<float> sigma_x(count), sigma_y(count), zncc(count);
  py::array_t<std::uint8_t> iterations(count), status(count);
  const auto store = [x = x.mutable_data(), y = y.mutable_data(), sigma_x = sigma_x.mutable_data(),
                      sigma_y = sigma_y.mutable_data(), zncc = zncc.mutable_data(),
                      iterations = iterations.mutable_data(),
                      status = status.mutable_data()](std::ptrdiff_t i, const SubsetResult& result) {
    x[i] = result.x;
    y[i] = result.y;
    sigma_x[i] = static_cast<float>(result.sigma_x);
    sigma_y[i] = static_cast<float>(result.sigma_y);
    zncc[i] = static_cast<float>(result.zncc);
    iterations[i] = static_cast<std::uint8_t>(result.iterations);
    status[i] = static_cast<std::uint8_t>(result.status);
  };
  {
    const py::gil_scoped_release unlocked;
    correlate_subsets(reference, target, selected, maps, count, limits, threads, store);
  }
  return py::make_tuple(x, y, sigma_x, sigma_y, zncc, iterations, status);
}

}  // namespace
}  // namespace rgbd_dic

PYBIND11_MODULE(_kernel, module) {
  using namespace rgbd_dic;
  using py::arg;
  module.doc() =
      "Subset-based digital image correlation by IC-GN; rgbd_dic_processing.core.correlation is its face.";

  module.def("instruction_sets", &instruction_sets, "Those this processor has, the fastest first.");
  module.def("use_instruction_set", &use_instruction_set, arg("name"),
             "What is made from now on runs on this one; at first the fastest.");

  py::class_<Reference>(module, "Reference", "Subsets of a reference image, prepared once.")
      .def(py::init(&make_reference), arg("image"), arg("centres"), arg("subset_size"), arg("degree"),
           arg("order") = 1, arg("smoothing") = 0.0, arg("threads") = 1,
           "image: uint8 or float32 (rows, cols); centres: float64 (N, 2), x y of the points to be followed; "
           "subset_size: odd, px; degree of the B-spline: 3 or 5; order of the increment: 1 affine, 2 "
           "quadratic; smoothing of the gradients, px; threads: 0 for all cores.")
      .def("status", &reference_status, arg("min_contrast"),
           "uint8 (N,): of each subset, in the reference itself.")
      .def(
          "expected_sigma", &reference_sigma, arg("noise"),
          "float32 (N, 2): standard uncertainty of x and y, px, that noise of this strength, grey levels, in "
          "the reference and in another image will cause; NaN without texture.")
      .def("__len__", &Reference::size);

  py::class_<SplineImage>(module, "Target", "An image that is searched.")
      .def(py::init(&make_target), arg("image"), arg("degree"),
           "image: uint8 or float32 (rows, cols); degree of the B-spline: 3 or 5.")
      .def("sample", &sample, arg("points"),
           "Grey values, float64 (M,), at points, float64 (M, 2) x y in px; NaN outside the image.");

  module.def(
      "seed_maps", &seed_maps, arg("stencil"), arg("homography"), arg("lens"), arg("reach"),
      arg("offsets") = py::none(), arg("indices") = py::none(), arg("threads") = 1,
      "Seeds of all subsets (M = N), or of those of indices, int32 (M,): float64 (M, 2, 6). stencil: float64 "
      "(9, N, 2), ideal px of the reference: centres, and the points reach px around them; homography: "
      "float64 "
      "(3, 3), ideal px; lens: float64 fx, fy, cx, cy, k1, k2 of the target; offsets: float64 (N, 2), px, "
      "are "
      "added.");

  module.def(
      "fit_pose", &fit_pose, arg("points"), arg("target"), arg("sigma"), arg("rotation"), arg("translation"),
      arg("lens"), arg("robust_sigmas"), arg("median_length"), arg("converged_px"), arg("max_iterations"),
      arg("misfit_iterations"),
      "Robust Gauss-Newton from a pose, float64 (3, 3) and (3,), to the one in which points, float64 (M, "
      "3), m, are seen at target, px, with uncertainty sigma, px, both float64 (M, 2); lens: fx, fy, cx, "
      "cy. Returns the pose, the Jacobian (6, M, 2), the weights (M, 2) and the misfit, px; None if it "
      "does not converge.");

  module.def("correlate", &correlate, arg("reference"), arg("target"), arg("seeds"),
             arg("indices") = py::none(), arg("max_iterations") = 20, arg("tolerance_px") = 1e-4,
             arg("min_zncc") = 0.8, arg("min_contrast") = 2.0, arg("max_shift_px") = 10.0,
             arg("max_misfit_px") = 0.5, arg("threads") = 0,
             "Correlates all subsets (M = N), or those of indices, int32 (M,), from seeds, float64 (N, 2, "
             "6). Returns x, y (float64, px), sigma_x, sigma_y (float32, px), zncc (float32), iterations, "
             "status (uint8), each (M,).");
}
