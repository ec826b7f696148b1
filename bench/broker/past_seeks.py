#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How soon a native viewer has drawn the past: it follows one who leads in a room to random moments of the last minute.

    past_seeks.py BIN_DIR CLIP [SEEKS]    programs, a folder or file of frames, how many (100)
"""
import json
import pathlib
import random
import subprocess
import sys
import tempfile
import threading
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import PING, PONG, TEXT, Peer, frame, ports_of

BIN, CLIP, SEEKS = pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 100
KEPT_S, EVERY_S, STREAM = 60, 0.4, "lab/horse"

folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-seeks-"))
programs = [subprocess.Popen([BIN / "eigencast-broker", "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={folder / 'port'}",
                              f"--data-dir={folder / 'broker'}", "--log-level=error", "--history-streams=**"])]
try:
    port = ports_of(folder / "port")[0]
    url = f"http://127.0.0.1:{port}/{STREAM}"
    programs.append(subprocess.Popen([BIN / "eigencast-sender", "play", CLIP, "--to", url, "--no-progress", "--wait"]))
    programs.append(subprocess.Popen([BIN / "eigencast-client", url, "--headless", "--size", "640x400", "--room", STREAM, "--name", "follower", "--json", folder / "report",
                                      "--wait", "600"]))
    leader = Peer(port, "/v1/subscribe", "eigencast.v2")
    leader.sock.settimeout(None)

    def say(op, **fields):
        leader.send(frame(TEXT, json.dumps({"op": op, **fields}).encode()))

    kept = threading.Event()

    def read():
        """Answers pings, and hears when a minute is kept."""
        while True:
            opcode, payload = leader.receive()
            if opcode == PING:
                leader.send(frame(PONG, payload))
            message = json.loads(payload) if opcode == TEXT else {}
            if message.get("op") == "ping":
                say("pong", id=message["id"], time_us=message["time_us"], peer_time_us=int(time.monotonic() * 1e6))
            spans = message.get("spans") if message.get("op") == "history" else None
            if spans and message["now_us"] - spans[0]["from_us"] > KEPT_S * 1e6:
                kept.set()

    threading.Thread(target=read, daemon=True).start()
    say("enter", room=STREAM, name="leader")
    say("floor", room=STREAM, floor="lead")
    while not kept.wait(1):
        say("history", stream=STREAM)
    for _ in range(SEEKS):
        say("say", room=STREAM, values={"seek": {"stream": STREAM, "at_us": int((time.time() - random.uniform(5, KEPT_S)) * 1e6), "speed": 0}})
        time.sleep(EVERY_S)
    programs[-1].terminate()
    programs[-1].wait(60)
    took = json.loads((folder / "report").read_text())["seek_us"]
    print(f"{took['count']} seeks, from the request to the picture: p50 {took['p50'] / 1000:.0f}, p90 {took['p90'] / 1000:.0f}, longest {took['max'] / 1000:.0f} ms")
finally:
    for program in reversed(programs):
        if program.poll() is None:
            program.kill()
        program.wait()
