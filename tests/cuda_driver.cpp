// A CUDA driver that runs nothing: it says that there is a card, keeps what is to be run on it in
// files of $CUDA_CODE, and does what concerns memory, in the host's. `cuda_code.py` reads them.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#define SAY_YES(name) \
    int name(...) { return 0; }

namespace {
// What Taichi asks of a card (cuda.h, CUdevice_attribute): an H100's, one block of which may have
// so many threads and so much memory to share.
int attribute(unsigned which) {
    switch (which) {
        case 1: return 1024;     // threads of a block
        case 8: return 49152;    // bytes that they share
        case 16: return 132;     // multiprocessors
        case 39: return 2048;    // threads of each
        case 75: return 9;       // compute capability
        case 97: return 232448;  // bytes that a block may share where it asks
        case 106: return 32;     // blocks of a multiprocessor
        case 115: return 1;      // pools of memory
        default: return 0;
    }
}

void fill(void* at, uint32_t value, size_t count) {
    for (size_t i = 0; i < count; i++) static_cast<uint32_t*>(at)[i] = value;
}

int allocate(void** at, size_t bytes) {
    *at = std::calloc(1, bytes + 256);
    return *at ? 0 : 2;
}

int counted = 0;
}  // namespace

extern "C" {
SAY_YES(cuInit)
SAY_YES(cuCtxSetCurrent)
SAY_YES(cuCtxSetLimit)
SAY_YES(cuEventDestroy)
SAY_YES(cuEventElapsedTime)
SAY_YES(cuEventRecord)
SAY_YES(cuEventSynchronize)
SAY_YES(cuExternalMemoryGetMappedBuffer)
SAY_YES(cuExternalMemoryGetMappedMipmappedArray)
SAY_YES(cuFuncSetAttribute)
SAY_YES(cuImportExternalMemory)
SAY_YES(cuImportExternalSemaphore)
SAY_YES(cuLaunchKernel)
SAY_YES(cuMemAdvise)
SAY_YES(cuMemFreeAsync)
SAY_YES(cuMemFree_v2)
SAY_YES(cuMemPoolSetAttribute)
SAY_YES(cuMipmappedArrayGetLevel)
SAY_YES(cuPointerGetAttribute)
SAY_YES(cuSignalExternalSemaphoresAsync)
SAY_YES(cuStreamSynchronize)
SAY_YES(cuSurfObjectCreate)
SAY_YES(cuWaitExternalSemaphoresAsync)

int cuDeviceGetCount(int* count) { return *count = 1, 0; }
int cuDeviceGet(int* device, int) { return *device = 0, 0; }
int cuDeviceGetName(char* name, int room, int) { return std::snprintf(name, room, "none"), 0; }
int cuDeviceGetAttribute(int* value, unsigned which, int) { return *value = attribute(which), 0; }
int cuDeviceGetDefaultMemPool(void** pool, int) { return *pool = nullptr, 0; }
int cuDriverGetVersion(int* version) { return *version = 12080, 0; }
int cuCtxCreate_v2(void** context, unsigned, int) { return *context = &counted, 0; }
int cuCtxGetCurrent(void** context) { return *context = &counted, 0; }
int cuDevicePrimaryCtxRetain(void** context, int) { return *context = &counted, 0; }
int cuEventCreate(void** event, unsigned) { return *event = &counted, 0; }
int cuStreamCreate(void** stream, unsigned) { return *stream = nullptr, 0; }
int cuFuncGetAttribute(int* value, unsigned, void*) { return *value = 32, 0; }
int cuGetErrorName(int, const char** text) { return *text = "", 0; }
int cuGetErrorString(int, const char** text) { return *text = "", 0; }
int cuOccupancyMaxActiveBlocksPerMultiprocessor(int* blocks, void*, int, size_t) {
    return *blocks = 8, 0;
}
int cuMemGetInfo_v2(size_t* free, size_t* total) { return *free = *total = size_t(8) << 30, 0; }
int cuMemAlloc_v2(void** at, size_t bytes) { return allocate(at, bytes); }
int cuMemAllocAsync(void** at, size_t bytes, void*) { return allocate(at, bytes); }
int cuMemAllocManaged(void** at, size_t bytes, unsigned) { return allocate(at, bytes); }
int cuMemsetD8_v2(void* at, unsigned char value, size_t n) { return std::memset(at, value, n), 0; }
int cuMemsetD32_v2(void* at, uint32_t value, size_t n) { return fill(at, value, n), 0; }
int cuMemcpyDtoD_v2(void* to, void* from, size_t n) { return std::memmove(to, from, n), 0; }
int cuMemcpyDtoH_v2(void* to, void* from, size_t n) { return std::memmove(to, from, n), 0; }
int cuMemcpyHtoD_v2(void* to, void* from, size_t n) { return std::memmove(to, from, n), 0; }
int cuMemcpyDtoHAsync_v2(void* to, void* from, size_t n, void*) {
    return std::memmove(to, from, n), 0;
}
int cuMemcpyHtoDAsync_v2(void* to, void* from, size_t n, void*) {
    return std::memmove(to, from, n), 0;
}

int cuModuleLoadDataEx(void** module, const char* code, unsigned, void*, void*) {
    char name[512];
    std::snprintf(name, sizeof name, "%s/%03d.ptx", std::getenv("CUDA_CODE"), counted++);
    std::FILE* file = std::fopen(name, "w");
    if (!file) return 1;
    std::fputs(code, file);
    std::fclose(file);
    return *module = &counted, 0;
}
int cuModuleGetFunction(void** function, void*, const char*) { return *function = &counted, 0; }
}
