// A GenTL producer (GenICam GenTL 1.6) with one ToF camera that has the features of a Blaze and obeys the test.
//
// FAKE_BLAZE names a folder: device.xml (its features, see fake_blaze.py), memory.bin (its registers, and the faults that it is to have,
// both mapped and shared with the test), frame.bin (range, intensity and confidence, uint16 each; then those of the next
// frame, if it plays several) and, if it is there, sent.csv, which gets a line `frame number,host time,device time,index`
// for each frame that it sends.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace {

using Handle = void*;
enum : int32_t {
  kOk = 0, kError = -1001, kNotImplemented = -1003, kAccessDenied = -1005, kInvalidHandle = -1006, kInvalidId = -1007,
  kIo = -1010, kTimeout = -1011, kAbort = -1012, kNotAvailable = -1014, kInvalidAddress = -1015, kTooSmall = -1016,
  kInvalidIndex = -1017
};
enum : int32_t { kString = 1, kUint32 = 6, kUint64 = 8, kPointer = 10, kBool8 = 11, kSize = 12, kInt32 = 5 };
constexpr int32_t kNewBufferEvent = 1;
constexpr uint32_t kC16 = 0x011000B8, kAbc32f = 0x026000C0;
constexpr size_t kMemory = 4096;
const char kDeviceId[] = "FAKE_BLAZE_0";

// Registers (fake_blaze.py has the same addresses) and faults.
enum : size_t {
  kFrameRate = 0x020, kEnable = 0x044, kFormat = 0x050, kScale = 0x078, kInvalid = 0x0A8, kFocal = 0x0B0,
  kCentreU = 0x0B8, kCentreV = 0x0C0, kWidth = 0x0C8, kHeight = 0x0CC, kStart = 0x0D0, kStop = 0x0D4,
  kLatch = 0x0E0, kLatched = 0x0E8,
  kPresent = 0x800, kFrozen = 0x804, kFail = 0x808, kSkip = 0x80C, kMade = 0x810, kSkew = 0x818, kOffset = 0x820,
  kJitter = 0x828, kTick = 0x830, kTicksOnly = 0x834, kPlayed = 0x838
};

template <typename Clock>
int64_t nanoseconds() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch()).count();
}

// Host time and steady time of one moment, to 20 us, however busy the computer is.
std::pair<int64_t, int64_t> both_clocks() {
  for (;;) {
    const int64_t before = nanoseconds<std::chrono::steady_clock>();
    const int64_t host = nanoseconds<std::chrono::system_clock>();
    const int64_t after = nanoseconds<std::chrono::steady_clock>();
    if (after - before < 20'000) return {host, (before + after) / 2};
  }
}

const uint8_t* map_file(const std::string& path, size_t* size) {
  const int file = ::open(path.c_str(), O_RDONLY);
  struct stat about;
  if (file < 0 || ::fstat(file, &about) != 0) return nullptr;
  void* mapped = ::mmap(nullptr, *size = size_t(about.st_size), PROT_READ, MAP_SHARED, file, 0);
  ::close(file);
  return mapped == MAP_FAILED ? nullptr : static_cast<const uint8_t*>(mapped);
}

struct Part {
  uint64_t offset, size, type, format;
};

struct Buffer {
  uint8_t* data;
  size_t size;
  void* user;
  bool owned, queued = false, incomplete = false;
  uint64_t timestamp_ns = 0, frame_id = 0;
  std::vector<Part> parts;
};

struct Camera {
  uint8_t* memory = nullptr;
  std::string folder;
  const uint8_t* frames = nullptr;
  size_t frames_size = 0;
  int log = -1;
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<Buffer*> announced;
  std::deque<Buffer*> input, output;
  std::thread thread;
  bool open = false, streaming = false, ending = false, killed = false;
  uint64_t frame_id = 0, fired = 0;

  template <typename T>
  T get(size_t address) const {
    T value;
    std::memcpy(&value, memory + address, sizeof value);
    return value;
  }
  template <typename T>
  void set(size_t address, T value) {
    std::memcpy(memory + address, &value, sizeof value);
  }
  bool present() const { return memory != nullptr && get<uint32_t>(kPresent) != 0; }
  size_t pixels() const { return size_t(get<uint32_t>(kWidth)) * get<uint32_t>(kHeight); }
  size_t payload() const { return pixels() * (12 + 2 + 2); }

  size_t frame_count() const { return frames_size / (6 * pixels()); }

  // The clock of the camera: it starts at another time, and runs at another rate.
  uint64_t now_ns(int64_t steady_ns = nanoseconds<std::chrono::steady_clock>()) const {
    return uint64_t(double(steady_ns) * (1 + 1e-6 * get<double>(kSkew))) + uint64_t(get<int64_t>(kOffset));
  }

  // Time in a sequence that is played there and back by the host's clock, in frames.
  double played(int64_t host_ns) const {
    const int64_t there_ns = get<int64_t>(kPlayed);
    return double(host_ns % (2 * there_ns)) * double(frame_count() - 1) / double(there_ns);
  }

  // How long until the next exposure: of a sequence, until the moment that its next frame shows.
  std::chrono::nanoseconds until_due() const {
    const double at = played(nanoseconds<std::chrono::system_clock>());
    const double step_ns = double(get<int64_t>(kPlayed)) / double(frame_count() - 1);
    return std::chrono::nanoseconds(int64_t((std::floor(at) + 1 - at) * step_ns));
  }

  void fill(Buffer& buffer, size_t index) {
    const size_t count = pixels(), width = get<uint32_t>(kWidth);
    const auto* source = reinterpret_cast<const uint16_t*>(frames) + 3 * count * index;
    buffer.parts.clear();
    uint64_t offset = 0;
    for (size_t component = 0; component < 3; ++component) {
      if (get<uint32_t>(kEnable + 4 * component) == 0) continue;
      const uint32_t format = get<uint32_t>(kFormat + 4 * component);
      const uint16_t* values = source + component * count;
      uint8_t* target = buffer.data + offset;
      uint64_t size = 2 * count;
      if (format == kAbc32f) {
        size = 12 * count;
        const double scale = get<double>(kScale), focal = get<double>(kFocal), invalid = get<double>(kInvalid);
        const double u0 = get<double>(kCentreU), v0 = get<double>(kCentreV);
        for (size_t i = 0; i < count; ++i) {
          const double z = scale * values[i];
          const double x = (double(i % width) - u0) * z / focal, y = (double(i / width) - v0) * z / focal;
          const float none = float(invalid);
          const float point[3] = {values[i] ? float(x) : none, values[i] ? float(y) : none, values[i] ? float(z) : none};
          std::memcpy(target + 12 * i, point, sizeof point);
        }
      } else {
        std::memcpy(target, values, size);
      }
      const uint64_t types[] = {5, 1, 9};  // 3D image, 2D image, confidence map
      buffer.parts.push_back({offset, size, types[component], format});
      offset += size;
    }
  }

  void stream() {
    std::mt19937 random(1);
    const bool plays = get<int64_t>(kPlayed) > 0 && frame_count() > 1;
    auto due = std::chrono::steady_clock::now();
    std::unique_lock<std::mutex> lock(mutex);
    while (!ending) {
      if (plays)
        due = std::chrono::steady_clock::now() + until_due();
      else
        due += std::chrono::nanoseconds(int64_t(1e9 / get<double>(kFrameRate)));
      changed.wait_until(lock, due, [this] { return ending; });
      if (ending || !streaming || !present() || get<uint32_t>(kFrozen)) continue;
      const auto [host_ns, steady_ns] = both_clocks();
      const uint64_t taken_ns = now_ns(steady_ns);
      size_t index = plays ? size_t(std::llround(played(host_ns))) : 0;
      if (index >= frame_count()) index = 2 * (frame_count() - 1) - index;
      ++frame_id;
      if (const uint32_t skip = get<uint32_t>(kSkip)) {
        set(kSkip, skip - 1);
        continue;
      }
      const double jitter_s = get<double>(kJitter);
      if (jitter_s > 0) {
        lock.unlock();
        std::this_thread::sleep_for(
            std::chrono::duration<double>(std::uniform_real_distribution<>(0, jitter_s)(random)));
        lock.lock();
      }
      if (input.empty()) continue;
      Buffer* buffer = input.front();
      input.pop_front();
      buffer->queued = false;
      buffer->timestamp_ns = taken_ns;
      buffer->frame_id = frame_id;
      fill(*buffer, index);
      if (log >= 0)
        dprintf(log, "%llu,%lld,%llu,%zu\n", static_cast<unsigned long long>(frame_id), static_cast<long long>(host_ns),
                static_cast<unsigned long long>(taken_ns), index);
      const uint32_t fail = get<uint32_t>(kFail);
      buffer->incomplete = fail > 0;
      if (fail > 0) set(kFail, fail - 1);
      set(kMade, get<uint32_t>(kMade) + 1);
      output.push_back(buffer);
      ++fired;
      changed.notify_all();
    }
  }
};

Camera camera;
Handle const kTl = &camera.memory;
Handle const kInterface = &camera.folder;
Handle const kDevice = &camera.frames;
Handle const kPort = &camera.mutex;
Handle const kStream = &camera.announced;
Handle const kEvent = &camera.fired;

int32_t put(int32_t kind, const void* value, size_t size, int32_t* type, void* buffer, size_t* room) {
  if (type != nullptr) *type = kind;
  if (buffer != nullptr) {
    if (*room < size) return kTooSmall;
    std::memcpy(buffer, value, size);
  }
  *room = size;
  return kOk;
}
int32_t put_text(const std::string& text, int32_t* type, void* buffer, size_t* room) {
  return put(kString, text.c_str(), text.size() + 1, type, buffer, room);
}
template <typename T>
int32_t put_number(int32_t kind, T value, int32_t* type, void* buffer, size_t* room) {
  return put(kind, &value, sizeof value, type, buffer, room);
}

// ID, vendor, model, ... : texts by their number; an empty one is not available.
int32_t put_named(const std::vector<std::string>& texts, int32_t command, int32_t* type, void* buffer, size_t* room) {
  if (command < 0 || size_t(command) >= texts.size() || texts[command].empty()) return kNotAvailable;
  return put_text(texts[command], type, buffer, room);
}

int32_t producer_info(int32_t command, int32_t* type, void* buffer, size_t* room) {
  if (command >= 8 && command <= 10) {
    const uint32_t numbers[] = {0, 1, 6};
    return put_number(command == 8 ? kInt32 : kUint32, numbers[command - 8], type, buffer, room);
  }
  return put_named({"FakeTL", "rgbd_dic", "fake ToF producer", "1.0", "Custom", "fake_blaze.cti", camera.folder,
                    "fake ToF producer"}, command, type, buffer, room);
}
int32_t device_info(int32_t command, int32_t* type, void* buffer, size_t* room) {
  if (command == 5) return put_number<int32_t>(kInt32, camera.open ? 5 : 1, type, buffer, room);
  if (command == 9) return put_number<uint64_t>(kUint64, 1000000000 / camera.get<uint32_t>(kTick), type, buffer, room);
  return put_named({kDeviceId, "rgbd_dic", "fake blaze-101", "Custom", "fake blaze-101", "", "lower", "24000101", "1"},
                   command, type, buffer, room);
}
void end_stream() {
  {
    std::lock_guard<std::mutex> lock(camera.mutex);
    camera.ending = true;
    camera.streaming = false;
    camera.changed.notify_all();
  }
  if (camera.thread.joinable()) camera.thread.join();
}

}  // namespace

#ifndef FAKE_BLAZE_FOLDER
#define FAKE_BLAZE_FOLDER nullptr  // where the camera is if the environment does not say it
#endif

#define GENTL extern "C" __attribute__((visibility("default"))) int32_t

// ---- library ----
GENTL GCInitLib() {
  const char* named = std::getenv("FAKE_BLAZE");
  const char* folder = named != nullptr ? named : FAKE_BLAZE_FOLDER;
  if (folder == nullptr) return kError;
  camera.folder = folder;
  const int file = ::open((camera.folder + "/memory.bin").c_str(), O_RDWR);
  if (file < 0) return kError;
  void* mapped = ::mmap(nullptr, kMemory, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (mapped == MAP_FAILED) return kError;
  camera.memory = static_cast<uint8_t*>(mapped);
  camera.frames = map_file(camera.folder + "/frame.bin", &camera.frames_size);
  camera.log = ::open((camera.folder + "/sent.csv").c_str(), O_WRONLY | O_APPEND);
  return camera.frames == nullptr || camera.frame_count() == 0 ? kError : kOk;
}
GENTL GCCloseLib() {
  end_stream();
  if (camera.memory != nullptr) ::munmap(camera.memory, kMemory);
  if (camera.frames != nullptr) ::munmap(const_cast<uint8_t*>(camera.frames), camera.frames_size);
  if (camera.log >= 0) ::close(camera.log);
  camera.memory = nullptr;
  camera.frames = nullptr;
  camera.log = -1;
  return kOk;
}
GENTL GCGetInfo(int32_t c, int32_t* t, void* b, size_t* s) { return producer_info(c, t, b, s); }
GENTL GCGetLastError(int32_t* code, char* text, size_t* room) {
  *code = kOk;
  return put_text("the fake camera does not do that", nullptr, text, room);
}

// ---- ports ----
GENTL GCReadPort(Handle port, uint64_t address, void* buffer, size_t* size) {
  if (port != kPort) return kNotImplemented;
  if (!camera.present()) return kIo;
  if (address + *size > kMemory) return kInvalidAddress;
  std::memcpy(buffer, camera.memory + address, *size);
  return kOk;
}
GENTL GCWritePort(Handle port, uint64_t address, const void* buffer, size_t* size) {
  if (port != kPort) return kNotImplemented;
  if (!camera.present()) return kIo;
  if (address + *size > 0x800) return kInvalidAddress;
  std::lock_guard<std::mutex> lock(camera.mutex);
  std::memcpy(camera.memory + address, buffer, *size);
  if (address == kStart) camera.streaming = true;
  if (address == kStop) camera.streaming = false;
  if (address == kLatch) camera.set(kLatched, camera.now_ns());
  return kOk;
}
GENTL GCGetPortInfo(Handle port, int32_t c, int32_t* t, void* b, size_t* s) {
  if (c >= 5 && c <= 10) return put_number<uint8_t>(kBool8, c == 5 || c == 7 || c == 8, t, b, s);
  const std::string module = port == kPort ? "Device" : "TLSystem";
  std::vector<std::string> texts = {module, "rgbd_dic", "fake blaze-101", "Custom", module};
  texts.resize(13);
  texts[11] = "1.0", texts[12] = port == kPort ? "Device" : "Port";
  return put_named(texts, c, t, b, s);
}
GENTL GCGetPortURL(Handle port, char* url, size_t* room) {
  if (port != kPort) return kNotAvailable;
  return put_text("File:///" + camera.folder + "/device.xml?SchemaVersion=1.1.0", nullptr, url, room);
}
GENTL GCGetNumPortURLs(Handle port, uint32_t* count) {
  *count = port == kPort;
  return port == kPort ? kOk : kNotAvailable;
}
GENTL GCGetPortURLInfo(Handle port, uint32_t, int32_t c, int32_t* t, void* b, size_t* s) {
  if (port != kPort || c != 0) return kNotAvailable;
  if (t != nullptr) *t = kString;
  return GCGetPortURL(port, static_cast<char*>(b), s);
}
GENTL GCReadPortStacked(Handle, void*, size_t*) { return kNotImplemented; }
GENTL GCWritePortStacked(Handle, void*, size_t*) { return kNotImplemented; }

// ---- events ----
GENTL GCRegisterEvent(Handle source, int32_t event, Handle* handle) {
  if (source != kStream || event != kNewBufferEvent) return kNotImplemented;
  camera.killed = false;
  *handle = kEvent;
  return kOk;
}
GENTL GCUnregisterEvent(Handle, int32_t) { return kOk; }
GENTL EventGetData(Handle, void* data, size_t* size, uint64_t timeout_ms) {
  std::unique_lock<std::mutex> lock(camera.mutex);
  const auto ready = [] { return camera.killed || !camera.output.empty(); };
  if (!camera.changed.wait_for(lock, std::chrono::milliseconds(std::min<uint64_t>(timeout_ms, 3600000)), ready))
    return kTimeout;
  if (camera.killed) {
    camera.killed = false;
    return kAbort;
  }
  Buffer* buffer = camera.output.front();
  camera.output.pop_front();
  void* event[2] = {buffer, buffer->user};
  return put(kPointer, event, sizeof event, nullptr, data, size);
}
GENTL EventGetDataInfo(Handle, const void* in, size_t, int32_t c, int32_t* t, void* b, size_t* s) {
  return c == 0 ? put(kPointer, in, sizeof(void*), t, b, s) : kNotAvailable;
}
GENTL EventGetInfo(Handle, int32_t c, int32_t* t, void* b, size_t* s) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  if (c == 0) return put_number<int32_t>(kInt32, kNewBufferEvent, t, b, s);
  if (c == 1) return put_number<size_t>(kSize, camera.output.size(), t, b, s);
  if (c == 2) return put_number<uint64_t>(kUint64, camera.fired, t, b, s);
  return put_number<size_t>(kSize, 2 * sizeof(void*), t, b, s);
}
GENTL EventFlush(Handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  camera.output.clear();
  return kOk;
}
GENTL EventKill(Handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  camera.killed = true;
  camera.changed.notify_all();
  return kOk;
}

// ---- system and interface ----
GENTL TLOpen(Handle* tl) { return *tl = kTl, kOk; }
GENTL TLClose(Handle) { return kOk; }
GENTL TLGetInfo(Handle, int32_t c, int32_t* t, void* b, size_t* s) { return producer_info(c, t, b, s); }
GENTL TLGetNumInterfaces(Handle, uint32_t* count) { return *count = 1, kOk; }
GENTL TLGetInterfaceID(Handle, uint32_t i, char* b, size_t* s) {
  return i == 0 ? put_text("FAKE_IF", nullptr, b, s) : kInvalidIndex;
}
GENTL TLGetInterfaceInfo(Handle, const char*, int32_t c, int32_t* t, void* b, size_t* s) {
  return put_named({"FAKE_IF", "fake interface", "Custom"}, c, t, b, s);
}
GENTL TLOpenInterface(Handle, const char*, Handle* handle) { return *handle = kInterface, kOk; }
GENTL TLUpdateInterfaceList(Handle, uint8_t* changed, uint64_t) {
  if (changed != nullptr) *changed = 1;
  return kOk;
}
GENTL IFClose(Handle) { return kOk; }
GENTL IFGetInfo(Handle, int32_t c, int32_t* t, void* b, size_t* s) { return TLGetInterfaceInfo(kTl, "", c, t, b, s); }
GENTL IFGetParentTL(Handle, Handle* tl) { return *tl = kTl, kOk; }
GENTL IFGetNumDevices(Handle, uint32_t* count) { return *count = camera.present(), kOk; }
GENTL IFGetDeviceID(Handle, uint32_t i, char* b, size_t* s) {
  return i == 0 && camera.present() ? put_text(kDeviceId, nullptr, b, s) : kInvalidIndex;
}
GENTL IFUpdateDeviceList(Handle, uint8_t* changed, uint64_t) {
  if (changed != nullptr) *changed = 1;
  return kOk;
}
GENTL IFGetDeviceInfo(Handle, const char*, int32_t c, int32_t* t, void* b, size_t* s) { return device_info(c, t, b, s); }
GENTL IFOpenDevice(Handle, const char*, int32_t, Handle* handle) {
  if (!camera.present()) return kInvalidId;
  if (camera.open) return kAccessDenied;
  camera.open = true;
  *handle = kDevice;
  return kOk;
}

// ---- device ----
GENTL DevGetPort(Handle, Handle* port) { return *port = kPort, kOk; }
GENTL DevGetParentIF(Handle, Handle* handle) { return *handle = kInterface, kOk; }
GENTL DevGetInfo(Handle, int32_t c, int32_t* t, void* b, size_t* s) { return device_info(c, t, b, s); }
GENTL DevGetNumDataStreams(Handle, uint32_t* count) { return *count = 1, kOk; }
GENTL DevGetDataStreamID(Handle, uint32_t, char* b, size_t* s) { return put_text("FAKE_DS", nullptr, b, s); }
GENTL DevOpenDataStream(Handle, const char*, Handle* handle) { return *handle = kStream, kOk; }
GENTL DevClose(Handle) { return camera.open = false, kOk; }

// ---- data stream ----
GENTL DSGetParentDev(Handle, Handle* handle) { return *handle = kDevice, kOk; }
GENTL DSGetInfo(Handle, int32_t c, int32_t* t, void* b, size_t* s) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  switch (c) {
    case 0: return put_text("FAKE_DS", t, b, s);
    case 1: case 6: return put_number<uint64_t>(kUint64, camera.fired, t, b, s);
    case 2: return put_number<uint64_t>(kUint64, 0, t, b, s);
    case 3: return put_number<size_t>(kSize, camera.announced.size(), t, b, s);
    case 4: return put_number<size_t>(kSize, camera.input.size(), t, b, s);
    case 5: return put_number<size_t>(kSize, camera.output.size(), t, b, s);
    case 7: return put_number<size_t>(kSize, camera.payload(), t, b, s);
    case 8: return put_number<uint8_t>(kBool8, camera.thread.joinable(), t, b, s);
    case 9: return put_number<uint8_t>(kBool8, 1, t, b, s);
    case 10: return put_text("Custom", t, b, s);
    case 12: return put_number<size_t>(kSize, 1, t, b, s);
    default: return kNotAvailable;
  }
}
GENTL DSAnnounceBuffer(Handle, void* data, size_t size, void* user, Handle* handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  if (size < camera.payload()) return kTooSmall;
  camera.announced.push_back(new Buffer{static_cast<uint8_t*>(data), size, user, false});
  *handle = camera.announced.back();
  return kOk;
}
GENTL DSAllocAndAnnounceBuffer(Handle, size_t size, void* user, Handle* handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  camera.announced.push_back(new Buffer{new uint8_t[size], size, user, true});
  *handle = camera.announced.back();
  return kOk;
}
GENTL DSGetBufferID(Handle, uint32_t i, Handle* handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  if (i >= camera.announced.size()) return kInvalidIndex;
  *handle = camera.announced[i];
  return kOk;
}
GENTL DSQueueBuffer(Handle, Handle handle) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  auto* buffer = static_cast<Buffer*>(handle);
  if (!buffer->queued) camera.input.push_back(buffer);
  buffer->queued = true;
  return kOk;
}
GENTL DSFlushQueue(Handle, int32_t) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  camera.input.clear();
  camera.output.clear();
  for (Buffer* buffer : camera.announced) buffer->queued = false;
  return kOk;
}
GENTL DSRevokeBuffer(Handle, Handle handle, void** data, void** user) {
  std::lock_guard<std::mutex> lock(camera.mutex);
  auto* buffer = static_cast<Buffer*>(handle);
  for (auto it = camera.announced.begin(); it != camera.announced.end(); ++it) {
    if (*it != buffer) continue;
    camera.announced.erase(it);
    if (data != nullptr) *data = buffer->data;
    if (user != nullptr) *user = buffer->user;
    if (buffer->owned) delete[] buffer->data;
    delete buffer;
    return kOk;
  }
  return kInvalidHandle;
}
GENTL DSStartAcquisition(Handle, int32_t, uint64_t) {
  end_stream();
  camera.ending = false;
  camera.frame_id = 0;
  camera.thread = std::thread([] { camera.stream(); });
  return kOk;
}
GENTL DSStopAcquisition(Handle, int32_t) { return end_stream(), kOk; }
GENTL DSClose(Handle) { return end_stream(), kOk; }
GENTL DSGetBufferInfo(Handle, Handle handle, int32_t c, int32_t* t, void* b, size_t* s) {
  const auto* buffer = static_cast<const Buffer*>(handle);
  switch (c) {
    case 0: return put_number<const void*>(kPointer, buffer->data, t, b, s);
    case 1: case 9: case 27: return put_number<size_t>(kSize, buffer->size, t, b, s);
    case 2: return put_number<const void*>(kPointer, buffer->user, t, b, s);
    case 3: return put_number<uint64_t>(kUint64, buffer->timestamp_ns / camera.get<uint32_t>(kTick), t, b, s);
    case 28:
      if (camera.get<uint32_t>(kTicksOnly)) return kNotAvailable;
      return DSGetBufferInfo(nullptr, handle, 3, t, b, s);  // a tick that is not 1 ns is passed off as one
    case 4: case 17: return put_number<uint8_t>(kBool8, 1, t, b, s);
    case 5: return put_number<uint8_t>(kBool8, buffer->queued, t, b, s);
    case 6: case 29: case 30: case 31: return put_number<uint8_t>(kBool8, 0, t, b, s);
    case 7: return put_number<uint8_t>(kBool8, buffer->incomplete, t, b, s);
    case 8: return put_text("Custom", t, b, s);
    case 16: return put_number<uint64_t>(kUint64, buffer->frame_id, t, b, s);
    case 19: return put_number<size_t>(kSize, 10, t, b, s);  // multi-part
    case 26: return put_number<int32_t>(kInt32, 1, t, b, s);
    default: return kNotAvailable;
  }
}
GENTL DSGetBufferChunkData(Handle, Handle, void*, size_t*) { return kNotImplemented; }
GENTL DSGetNumBufferParts(Handle, Handle handle, uint32_t* count) {
  return *count = uint32_t(static_cast<Buffer*>(handle)->parts.size()), kOk;
}
GENTL DSGetBufferPartInfo(Handle, Handle handle, uint32_t i, int32_t c, int32_t* t, void* b, size_t* s) {
  const auto* buffer = static_cast<const Buffer*>(handle);
  if (i >= buffer->parts.size()) return kInvalidIndex;
  const Part& part = buffer->parts[i];
  switch (c) {
    case 0: return put_number<const void*>(kPointer, buffer->data + part.offset, t, b, s);
    case 1: return put_number<size_t>(kSize, part.size, t, b, s);
    case 2: return put_number<size_t>(kSize, part.type, t, b, s);
    case 3: return put_number<uint64_t>(kUint64, part.format, t, b, s);
    case 4: return put_number<uint64_t>(kUint64, 4, t, b, s);
    case 5: return put_number<size_t>(kSize, camera.get<uint32_t>(kWidth), t, b, s);
    case 6: case 11: return put_number<size_t>(kSize, camera.get<uint32_t>(kHeight), t, b, s);
    case 7: case 8: case 9: return put_number<size_t>(kSize, 0, t, b, s);
    case 10: case 12: return put_number<uint64_t>(kUint64, 0, t, b, s);
    case 13: return put_number<uint64_t>(kUint64, part.type == 5 ? 4 : part.type == 1 ? 1 : 6, t, b, s);
    default: return kNotAvailable;
  }
}

// ---- what producers of GenTL 1.6 may leave out ----
GENTL DSAnnounceCompositeBuffer(Handle, size_t, void**, size_t*, void*, Handle*) { return kNotImplemented; }
GENTL DSGetNumFlows(Handle, uint32_t* count) { return *count = 0, kNotImplemented; }
GENTL DSGetFlowInfo(Handle, uint32_t, int32_t, int32_t*, void*, size_t*) { return kNotImplemented; }
GENTL DSGetNumBufferSegments(Handle, Handle, uint32_t* count) { return *count = 0, kNotImplemented; }
GENTL DSGetBufferSegmentInfo(Handle, Handle, uint32_t, int32_t, int32_t*, void*, size_t*) { return kNotImplemented; }
