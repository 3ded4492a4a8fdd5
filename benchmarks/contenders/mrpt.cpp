// C functions that call MRPT's range-bearing EKF-SLAM, CRangeBearingKFSLAM2D.

#include <mrpt/obs/CActionCollection.h>
#include <mrpt/obs/CActionRobotMovement2D.h>
#include <mrpt/obs/CObservationBearingRange.h>
#include <mrpt/obs/CSensoryFrame.h>
#include <mrpt/poses/CPosePDFGaussian.h>
#include <mrpt/slam/CRangeBearingKFSLAM2D.h>

#include <cmath>
#include <exception>
#include <string>
#include <utility>
#include <vector>

namespace {

using mrpt::obs::CActionCollection;
using mrpt::obs::CSensoryFrame;

class Filter : public mrpt::slam::CRangeBearingKFSLAM2D {
   public:
    // Start with an existing map: state (D) and covariance (D, D), landmark i with the id i.
    void place(long D, const double *x, const double *P) {
        m_xkk.resize(D);
        m_pkk.setSize(D, D);
        for (long i = 0; i < D; ++i) {
            m_xkk[i] = x[i];
            for (long j = 0; j < D; ++j) m_pkk(i, j) = P[i * D + j];
        }
        for (long i = 0; i < (D - 3) / 2; ++i) m_IDs.insert(i, i);
    }

    void read(double *x, double *P) const {
        const long D = m_xkk.size();
        for (long i = 0; i < D; ++i) {
            x[i] = m_xkk[i];
            for (long j = 0; j < D; ++j) P[i * D + j] = m_pkk(i, j);
        }
    }

    std::vector<std::pair<CActionCollection::Ptr, CSensoryFrame::Ptr>> steps;
    std::string complaint;
};

// Motion of one step in the frame of the robot: an exact arc, with noise on speed and turn rate.
CActionCollection::Ptr action(double v, double omega, double dt, const double *sigmas) {
    const double a = 0.5 * omega * dt, s2 = a * a;
    const bool small = std::fabs(a) < 1e-2;
    const double sinc = small ? 1 - s2 / 6 * (1 - s2 / 20) : std::sin(a) / a;
    const double slope = small ? -a / 3 * (1 - s2 / 10) : (std::cos(a) - sinc) / a;
    const double c = std::cos(a), s = std::sin(a), chord = v * dt * sinc;
    const double longer = 0.5 * v * dt * dt * slope, turned = 0.5 * dt * chord;
    const double g[3][2] = {{dt * sinc * c, longer * c - turned * s}, {dt * sinc * s, longer * s + turned * c}, {0, dt}};
    auto change = mrpt::poses::CPosePDFGaussian::Create();
    change->mean = mrpt::poses::CPose2D(chord * c, chord * s, omega * dt);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            change->cov(i, j) = g[i][0] * sigmas[0] * sigmas[0] * g[j][0] + g[i][1] * sigmas[1] * sigmas[1] * g[j][1];
    mrpt::obs::CActionRobotMovement2D movement;
    movement.poseChange = change;
    auto made = CActionCollection::Create();
    made->insert(movement);
    return made;
}

}  // namespace

extern "C" void *mrpt_new(long D, const double *x, const double *P, const double *sigmas, long method) {
    auto *filter = new Filter;
    filter->options.std_sensor_range = static_cast<float>(sigmas[2]);
    filter->options.std_sensor_yaw = static_cast<float>(sigmas[3]);
    filter->KF_options.method = static_cast<mrpt::bayes::TKFMethod>(method);
    filter->place(D, x, P);
    return filter;
}

extern "C" void mrpt_free(void *filter) { delete static_cast<Filter *>(filter); }

// Convert the steps begin ... end-1 to MRPT's form. `reach` is the largest range that occurs.
extern "C" void mrpt_prepare(void *handle, const double *u, const double *dt, const long *first, const long *ids,
                             const double *z, long begin, long end, const double *sigmas, double reach) {
    auto &filter = *static_cast<Filter *>(handle);
    filter.steps.clear();
    for (long k = begin; k < end; ++k) {
        auto seen = mrpt::obs::CObservationBearingRange::Create();
        seen->minSensorDistance = 0;
        seen->maxSensorDistance = static_cast<float>(reach);
        seen->fieldOfView_yaw = static_cast<float>(2 * M_PI);
        for (long m = first[k]; m < first[k + 1]; ++m) {
            mrpt::obs::CObservationBearingRange::TMeasurement one;
            one.range = static_cast<float>(z[2 * m]);
            one.yaw = static_cast<float>(z[2 * m + 1]);
            one.pitch = 0;
            one.landmarkID = static_cast<int>(ids[m]);
            seen->sensedData.push_back(one);
        }
        auto frame = CSensoryFrame::Create();
        frame->insert(seen);
        filter.steps.emplace_back(action(u[2 * k], u[2 * k + 1], dt[k], sigmas), frame);
    }
}

// Take the converted steps. Returns the error message of MRPT, or null.
extern "C" const char *mrpt_run(void *handle) {
    auto &filter = *static_cast<Filter *>(handle);
    try {
        for (auto &step : filter.steps) filter.processActionObservation(step.first, step.second);
    } catch (const std::exception &error) {
        filter.complaint = error.what();
        return filter.complaint.c_str();
    }
    return nullptr;
}

extern "C" void mrpt_read(void *handle, double *x, double *P) { static_cast<Filter *>(handle)->read(x, P); }
