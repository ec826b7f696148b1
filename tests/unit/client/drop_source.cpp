// SPDX-License-Identifier: MIT
#include "tests/unit/client/drop_source.h"

#include <X11/Xatom.h>
#include <X11/Xlib.h>

#include <chrono>
#include <optional>
#include <thread>

namespace eigencast::testing {
namespace {

class DropSource {
 public:
  explicit DropSource(const std::string& display) : display_(XOpenDisplay(display.c_str())) {}
  ~DropSource() {
    if (display_ != nullptr) XCloseDisplay(display_);
  }
  DropSource(const DropSource&) = delete;
  DropSource& operator=(const DropSource&) = delete;

  bool drop(const std::string& uris) {
    if (display_ == nullptr) return false;
    const std::optional<Window> target = taker(XDefaultRootWindow(display_));
    if (!target) return false;
    target_ = *target;
    window_ = XCreateSimpleWindow(display_, XDefaultRootWindow(display_), 0, 0, 1, 1, 0, 0, 0);
    XSetSelectionOwner(display_, atom("XdndSelection"), window_, CurrentTime);
    const auto self = static_cast<long>(window_);
    const long list = static_cast<long>(atom("text/uri-list"));
    send("XdndEnter", {self, 5L << 24, list, 0, 0});
    send("XdndPosition", {self, 0, 100L << 16 | 100, CurrentTime, static_cast<long>(atom("XdndActionCopy"))});
    bool dropped = false;
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (std::chrono::steady_clock::now() < until) {
      if (XPending(display_) == 0) {
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
        continue;
      }
      XEvent event;
      XNextEvent(display_, &event);
      if (event.type == ClientMessage && event.xclient.message_type == atom("XdndStatus") && !dropped) {
        if ((event.xclient.data.l[1] & 1) == 0) return false;
        send("XdndDrop", {self, 0, CurrentTime, 0, 0});
        dropped = true;
      } else if (event.type == SelectionRequest) {
        answer(event.xselectionrequest, uris);
      } else if (event.type == ClientMessage && event.xclient.message_type == atom("XdndFinished")) {
        return true;
      }
    }
    return false;
  }

 private:
  Atom atom(const char* name) { return XInternAtom(display_, name, False); }

  /// The first window that says it takes drops.
  std::optional<Window> taker(Window from) {
    Atom type = 0;
    int format = 0;
    unsigned long count = 0, left = 0;
    unsigned char* data = nullptr;
    if (XGetWindowProperty(display_, from, atom("XdndAware"), 0, 1, False, XA_ATOM, &type, &format, &count, &left,
                           &data) == Success &&
        data != nullptr) {
      XFree(data);
      return from;
    }
    Window root = 0, parent = 0, *children = nullptr;
    unsigned int n = 0;
    std::optional<Window> found;
    if (XQueryTree(display_, from, &root, &parent, &children, &n) != 0 && children != nullptr) {
      for (unsigned int i = 0; i < n && !found; ++i) found = taker(children[i]);
      XFree(children);
    }
    return found;
  }

  void send(const char* message, const long (&values)[5]) {
    XEvent event{};
    event.xclient.type = ClientMessage;
    event.xclient.display = display_;
    event.xclient.window = target_;
    event.xclient.message_type = atom(message);
    event.xclient.format = 32;
    for (int i = 0; i < 5; ++i) event.xclient.data.l[i] = values[i];
    XSendEvent(display_, target_, False, NoEventMask, &event);
    XFlush(display_);
  }

  void answer(const XSelectionRequestEvent& request, const std::string& uris) {
    XChangeProperty(display_, request.requestor, request.property, request.target, 8, PropModeReplace,
                    reinterpret_cast<const unsigned char*>(uris.data()), static_cast<int>(uris.size()));
    XEvent reply{};
    reply.xselection.type = SelectionNotify;
    reply.xselection.requestor = request.requestor;
    reply.xselection.selection = request.selection;
    reply.xselection.target = request.target;
    reply.xselection.property = request.property;
    reply.xselection.time = request.time;
    XSendEvent(display_, request.requestor, False, NoEventMask, &reply);
    XFlush(display_);
  }

  Display* display_;
  Window window_ = 0, target_ = 0;
};

}  // namespace

bool drop_on_window(const std::string& display, const std::string& uris) {
  return DropSource(display).drop(uris);
}

bool set_display_density(const std::string& display, int dpi) {
  Display* const server = XOpenDisplay(display.c_str());
  if (server == nullptr) return false;
  const std::string resources = "Xft.dpi:\t" + std::to_string(dpi) + "\n";
  XChangeProperty(server, XDefaultRootWindow(server), XA_RESOURCE_MANAGER, XA_STRING, 8, PropModeReplace,
                  reinterpret_cast<const unsigned char*>(resources.data()), static_cast<int>(resources.size()));
  XCloseDisplay(server);
  return true;
}

}  // namespace eigencast::testing
