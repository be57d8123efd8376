// Rays in packets through embree: four times the pace of one by one where they lie close together.
//
// Embree is the copy that the package embreex carries; its headers it does not, so what is needed of
// its C interface, version 4, stands here. The function to call is passed by Python, which finds it.
#include <cstdint>
#include <type_traits>

#if defined(_WIN32)
#define RECAST_EXPORT extern "C" __declspec(dllexport)
#else
#define RECAST_EXPORT extern "C" __attribute__((visibility("default")))
#endif

namespace {

// RTCRayHitN; the last two only where embree was built for several levels of instances.
template <int N>
struct alignas(4 * N) Packet {
  float origin[3][N], near[N], direction[3][N], time[N], far[N];
  uint32_t mask[N], id[N], flags[N];
  float normal[3][N], u[N], v[N];
  uint32_t face[N], geometry[N], instance[N], instance_face[N];
};

// RTCIntersectArguments and RTCOccludedArguments, with room for fields of some builds.
struct Arguments {
  int32_t flags;
  uint32_t features;
  void *context, *filter, *intersect;
  float rest[4];
};

using Query = void (*)(const int32_t* valid, void* scene, void* packet, Arguments* arguments);

constexpr uint32_t kNone = ~0u;
constexpr int32_t kCoherent = 1 << 16;
constexpr float kNoHit = 1e37f;

// `done(ray, packet, lane)` for every ray.
template <int N, typename Done>
void query(Query ask, void* scene, const float* origins, const float* directions,
           const float* limits, int64_t count, bool coherent, const Done& done) {
  alignas(64) Packet<N> packet = {};
  alignas(64) int32_t valid[N];
  for (int64_t first = 0; first < count; first += N) {
    for (int lane = 0; lane < N; ++lane) {
      const bool used = first + lane < count;
      const int64_t ray = used ? first + lane : first;
      valid[lane] = used ? -1 : 0;
      for (int k = 0; k < 3; ++k) {
        packet.origin[k][lane] = origins[3 * ray + k];
        packet.direction[k][lane] = directions[3 * ray + k];
      }
      packet.near[lane] = 0;
      packet.far[lane] = limits ? limits[ray] : kNoHit;
      packet.mask[lane] = kNone;
      packet.face[lane] = packet.geometry[lane] = packet.instance[lane] = kNone;
    }
    Arguments arguments = {};
    arguments.flags = coherent ? kCoherent : 0;
    arguments.features = kNone;
    ask(valid, scene, &packet, &arguments);
    for (int lane = 0; lane < N && first + lane < count; ++lane) done(first + lane, packet, lane);
  }
}

template <typename Run>
void with_width(int64_t width, const Run& run) {
  if (width == 16)
    run(std::integral_constant<int, 16>());
  else if (width == 8)
    run(std::integral_constant<int, 8>());
  else
    run(std::integral_constant<int, 4>());
}

}  // namespace

// First hits of rays (N, 3), (N, 3) nearer than limits (N,), which may be null; face -1 for none.
// `ask`: rtcIntersect4, 8 or 16 as `width` says.
RECAST_EXPORT void recast_first_hits(void* ask, int64_t width, void* scene, const float* origins,
                                     const float* directions, const float* limits, int64_t count,
                                     int32_t coherent, float* distance, int32_t* face, float* u,
                                     float* v) {
  with_width(width, [&](auto lanes) {
    query<lanes.value>(Query(ask), scene, origins, directions, limits, count, coherent,
                       [&](int64_t ray, const auto& packet, int lane) {
                         const bool hit = packet.geometry[lane] != kNone;
                         distance[ray] = hit ? packet.far[lane] : kNoHit;
                         face[ray] = hit ? int32_t(packet.face[lane]) : -1;
                         u[ray] = hit ? packet.u[lane] : 0;
                         v[ray] = hit ? packet.v[lane] : 0;
                       });
  });
}

// Whether rays (N, 3), (N, 3) meet anything. `ask`: rtcOccluded4, 8 or 16.
RECAST_EXPORT void recast_occluded(void* ask, int64_t width, void* scene, const float* origins,
                                   const float* directions, int64_t count, int32_t coherent,
                                   uint8_t* blocked) {
  with_width(width, [&](auto lanes) {
    query<lanes.value>(Query(ask), scene, origins, directions, nullptr, count, coherent,
                       [&](int64_t ray, const auto& packet, int lane) {
                         blocked[ray] = packet.far[lane] < 0;
                       });
  });
}
