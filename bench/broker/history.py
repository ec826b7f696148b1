#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a broker's history takes, and how soon it shows any moment of it.

    bench/broker/history.py --broker BIN/eigencast-broker --sender BIN/eigencast-sender [--clip CLIP] [--seeks 200]
                            [--hours 1] [--client BIN/eigencast-client] [-- options of `eigencast-sender play`]

A sender plays a clip until a file of the history is whole (a minute). Copies of it, each begun a file's length after the
one before, make the hours that end now, which a new broker takes up. Then a viewer seeks random moments, with the pose
alone asked for. With `--client` a native viewer without a window, 1280 x 720, follows one who leads in a room to as many.
Prints a line of JSON: the stream's kbit/s, bytes kept an hour, and milliseconds from a seek to the join of its pose, and
to the native viewer's picture of it.
"""
import argparse
import json
import pathlib
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import BINARY, TEXT, Broker, Peer, control, frame, next_control, stay

HEADER, HEAD = 12, 17  # Bytes of a recording's header and of a record's head (docs/recording-format.md).


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def begun_at(recording, started_us):
    """The same recording, begun then."""
    size, = struct.unpack_from("<I", recording, HEADER)
    body = struct.pack("<Q", started_us) + recording[HEADER + HEAD + 8: HEADER + HEAD + size]
    head = recording[HEADER: HEADER + HEAD - 4]
    return recording[:HEADER] + head + struct.pack("<I", crc32c(head + body)) + body + recording[HEADER + HEAD + size:]


def frame_bytes(recording):
    """Of the sender's frames alone."""
    at, total = HEADER, 0
    while at < len(recording):
        size, kind = struct.unpack_from("<IB", recording, at)
        total += size if kind == 3 else 0
        at += HEAD + size
    return total


def record(options, folder):
    """A whole file of the history, and its seconds."""
    with Broker(options.broker, "--history-streams=**", f"--data-dir={folder}") as broker:
        sender = subprocess.Popen([options.sender, "play", options.clip, "--to", f"127.0.0.1:{broker.port}/a", *options.play],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while len(files := sorted((folder / "history").glob("*.ecrec"))) < 2:
                if sender.poll() is not None:
                    sys.exit("the sender ended")
                time.sleep(0.2)
            time.sleep(1)
        finally:
            sender.terminate()
            sender.wait()
    recording = files[0].read_bytes()
    seconds = struct.unpack_from("<Q", recording, len(recording) - 24 - HEAD + 5)[0] / 1e6  # Time of its end.
    return recording, seconds


def drawn_after(options, broker, folder, moments):
    """Milliseconds from a seek to its picture in a native viewer that follows."""
    lead = Peer(broker.port, "/v1/subscribe", "eigencast.v2")
    lead.send(control(op="enter", room="r", name="lead"))
    next_control(lead, "room")
    lead.send(control(op="floor", room="r", floor="lead"))
    viewer = subprocess.Popen([options.client, f"http://127.0.0.1:{broker.port}/a", "--headless", "--size=1280x720", "--rate=raw", "--room=r",
                               "--name=viewer", f"--json={folder / 'report'}"], stderr=subprocess.DEVNULL)
    while not any(member.get("name") == "viewer" for member in next_control(lead, "room").get("members", [])):
        pass
    time.sleep(3)  # Until it has the whole surface.
    threading.Thread(target=stay, args=(lead,), daemon=True).start()
    for at_us in moments:
        lead.send(control(op="say", room="r", values={"seek": {"stream": "a", "at_us": at_us, "speed": 0}}))
        time.sleep(0.4)
    viewer.terminate()
    viewer.wait()
    lead.sock.close()
    seek_us = json.loads((folder / "report").read_text())["seek_us"]
    return {"count": seek_us["count"], **{name: round(seek_us[name] / 1000, 1) for name in ("p50", "p90", "p99", "max")}}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--broker", required=True)
    parser.add_argument("--sender", required=True)
    parser.add_argument("--clip", default="torus")
    parser.add_argument("--seeks", type=int, default=200)
    parser.add_argument("--hours", type=float, default=1)
    parser.add_argument("--client")
    parser.add_argument("play", nargs="*")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        recording, seconds = record(options, folder)
        shutil.rmtree(folder / "history")
        (folder / "history").mkdir()
        files = int(options.hours * 3600 / seconds)
        first_us = int((time.time() - 5 - files * seconds) * 1e6)
        for number in range(files):
            (folder / f"history/a.{number:06}.ecrec").write_bytes(begun_at(recording, first_us + int(number * seconds * 1e6)))
        minutes = int(options.hours * 60) + 2
        with Broker(options.broker, "--history-streams=**", f"--history-minutes={minutes}", f"--data-dir={folder}") as broker:
            viewer = Peer(broker.port, "/v1/subscribe/a?rate=raw", "eigencast.v2")

            def ask(**message):
                viewer.send(frame(TEXT, json.dumps(message).encode()))

            def answer(*ops):
                while True:
                    opcode, payload = viewer.receive()
                    if opcode == TEXT and (message := json.loads(payload))["op"] in ops:
                        return message

            while True:
                ask(op="history", stream="a")
                spans = answer("history").get("spans", [])
                kept_s = sum(span["to_us"] - span["from_us"] for span in spans) / 1e6
                if kept_s > 0.98 * files * seconds:
                    break
                time.sleep(0.2)
            chance, times = random.Random(1), []
            for _ in range(options.seeks):
                at_us = chance.randrange(spans[0]["from_us"], spans[-1]["to_us"])
                begun = time.perf_counter()
                ask(op="seek", stream="a", at_us=at_us, speed=0)
                while "rewind" not in (message := answer("stream", "history")):
                    if "code" in message:
                        sys.exit(f"a seek was not done: {message}")
                while viewer.receive()[0] != BINARY:
                    pass
                times.append(1000 * (time.perf_counter() - begun))
            viewer.sock.close()
            drawn = {}
            if options.client:
                moments = [chance.randrange(spans[0]["from_us"], spans[-1]["to_us"]) for _ in range(options.seeks)]
                drawn = {"native_picture_ms": drawn_after(options, broker, folder, moments)}
    times.sort()
    part = {f"p{p}": round(times[min(len(times) - 1, p * len(times) // 100)], 2) for p in (50, 90, 95, 99)}
    print(json.dumps({"kbit_s": round(frame_bytes(recording) * 8 / seconds / 1000, 1),
                      "bytes_an_hour": round(len(recording) / seconds * 3600), "kept_s": round(kept_s), "seeks": len(times),
                      "first_pose_ms": {**part, "max": round(times[-1], 2)}, **drawn}))


if __name__ == "__main__":
    main()
