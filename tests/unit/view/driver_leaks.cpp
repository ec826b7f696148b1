// SPDX-License-Identifier: MIT

// Graphics drivers keep allocations for the life of the process, reachable only from their own data. EGL and GLX unload
// them before the leak check, which then takes these for leaks in code without a name. Under AddressSanitizer no
// library is unloaded.
#if defined(__SANITIZE_ADDRESS__)
extern "C" int dlclose(void*) {
  return 0;
}
extern "C" const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions() {
  return "leak:libLLVM\nleak:_dri.so\n";
}
#endif
