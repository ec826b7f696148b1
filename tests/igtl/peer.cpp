// SPDX-License-Identifier: MIT
// A peer of OpenIGTLink's own classes. It talks to a test by lines.
//   peer send PORT       connects, then sends a pose of a sheet for each line that it reads
//   peer receive         waits at a port that it prints, then prints each POLYDATA that comes
#include <igtlClientSocket.h>
#include <igtlPolyDataMessage.h>
#include <igtlServerSocket.h>
#include <igtlTimeStamp.h>

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

namespace {

constexpr unsigned kSide = 16;

int send(int port) {
  const auto socket = igtl::ClientSocket::New();
  if (socket->ConnectToServer("127.0.0.1", port) != 0) return 1;
  std::string line;
  for (int pose = 0; std::getline(std::cin, line); ++pose) {
    const auto points = igtl::PolyDataPointArray::New();
    const auto polygons = igtl::PolyDataCellArray::New(), strips = igtl::PolyDataCellArray::New();
    std::vector<float> heat;
    for (unsigned i = 0; i < kSide * kSide; ++i) {
      const float x = static_cast<float>(i % kSide), y = static_cast<float>(i / kSide);
      points->AddPoint(x / kSide + 0.1f * static_cast<float>(pose), y / kSide,
                       0.01f * x * static_cast<float>(pose % 5));
      heat.push_back(pose < 6 ? 0 : x * 1e5f);  // as loads come: the range is learnt
      const bool inside = i % kSide + 1 < kSide && i / kSide + 1 < kSide;
      if (!inside) continue;
      igtlUint32 square[4] = {i, i + 1, i + kSide + 1, i + kSide}, strip[4] = {i, i + 1, i + kSide, i + kSide + 1};
      if (i % 2 != 0)
        polygons->AddCell(4, square);
      else
        strips->AddCell(4, strip);
    }
    const auto attribute = igtl::PolyDataAttribute::New();
    attribute->SetType(igtl::PolyDataAttribute::POINT_SCALAR, 1);
    attribute->SetSize(kSide * kSide);
    attribute->SetName("heat");
    attribute->SetData(heat.data());
    const auto normals = igtl::PolyDataAttribute::New();  // not streamed
    normals->SetType(igtl::PolyDataAttribute::POINT_NORMAL);
    normals->SetSize(kSide * kSide);
    normals->SetName("up");
    std::vector<float> up(3 * kSide * kSide, 1.0f);
    normals->SetData(up.data());
    const auto message = igtl::PolyDataMessage::New();
    message->SetDeviceName("Sheet");
    message->SetPoints(points);
    message->SetPolygons(polygons);
    message->SetTriangleStrips(strips);
    message->AddAttribute(normals);
    message->AddAttribute(attribute);
    auto now = igtl::TimeStamp::New();
    now->GetTime();
    message->SetTimeStamp(now);
    message->Pack();
    if (!socket->Send(message->GetPackPointer(), message->GetPackSize())) return 1;
  }
  return 0;
}

int receive() {
  const auto server = igtl::ServerSocket::New();
  if (server->CreateServer(0) != 0) return 1;
  std::printf("%d\n", server->GetServerPort());
  std::fflush(stdout);
  const igtl::Socket::Pointer socket = server->WaitForConnection(60'000).GetPointer();
  if (socket.IsNull()) return 1;
  const auto header = igtl::MessageHeader::New();
  while (true) {
    header->InitPack();
    if (socket->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) return 0;
    header->Unpack();
    const auto message = igtl::PolyDataMessage::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    if (socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize()) != message->GetPackBodySize())
      return 0;
    if ((message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY) == 0) return 2;  // 1: its checksum counts
    auto stamp = igtl::TimeStamp::New();
    message->GetTimeStamp(stamp);
    const int points = message->GetPoints()->GetNumberOfPoints();
    igtlUint32 cells = message->GetPolygons()->GetNumberOfCells();
    std::printf("%s %d %u %d %.6f", message->GetDeviceName(), points, cells, message->GetNumberOfAttributes(),
                stamp->GetTimeStamp());
    if (message->GetNumberOfAttributes() > 0) std::printf(" %s", message->GetAttribute(0)->GetName());
    for (int i = 0; i < points; ++i) {
      float p[3];
      message->GetPoints()->GetPoint(static_cast<unsigned>(i), p);
      std::printf(" %.7g %.7g %.7g", static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2]));
    }
    for (igtlUint32 i = 0; i < cells; ++i) {
      igtlUint32 cell[3];
      if (message->GetPolygons()->GetCellSize(i) != 3) return 3;
      message->GetPolygons()->GetCell(i, cell);
      std::printf(" %u %u %u", cell[0], cell[1], cell[2]);
    }
    std::printf("\n");
    std::fflush(stdout);
  }
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  if (what == "send" && argc > 2) return send(std::atoi(argv[2]));
  if (what == "receive") return receive();
  return 64;
}
