#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How many brokers, NATS servers and megabits a crowd of viewers needs: the model of docs/scaling.md, and a simulation of it.

    bench/backbone/scaling.py [--viewers 10000 1000000 100000000] [--streams 10] [--cpu-s-per-million 6] ...

Every constant is a flag, so that figures measured on other machines (bench/broker/fanout.py, bench/backbone/edge.py) can be put in. The
simulation places viewers at brokers and streams among viewers at random and adds up what the model takes as a mean; --check compares the two.
"""
import argparse
import dataclasses
import math
import random


@dataclasses.dataclass
class Costs:
    """Of one machine's core; measured."""

    cpu_s_per_million: float = 6.0  # Deliveries, plain; TLS is about 1.7 times that.
    pose_us: float = 30.0  # Making one interpolated pose, once per stream and profile at each broker.
    hop_us: float = 200.0  # Taking one key from NATS by itself: four threads wake up; less where many come at once.
    idle_core: float = 0.005  # Of a broker that nobody watches: timers, signs of life.
    load: float = 0.6  # Of a core that is planned for; the rest is for bursts.
    viewers_per_broker: int = 20_000  # limits.max_connections


@dataclasses.dataclass
class Crowd:
    viewers: int
    streams: int
    watched: int = 1  # Streams that a viewer watches.
    key_rate: float = 30.0
    k: int = 3  # Poses per key.
    key_bytes: float = 190.0  # With envelope and framing.
    pose_bytes: float = 130.0
    asset_bytes: float = 1.3e6
    joins_per_s: float = 0.0  # Of the whole crowd.


SPEAKERS = 100  # Brokers without streams that give a sign of life in a second, of however many.
SIGN_BYTES = 60.0  # With what NATS puts around it.


@dataclasses.dataclass
class Plan:
    brokers: int
    core: float  # Share of one core that each broker uses.
    followed: float  # Streams that each broker follows or has.
    broker_mbit: float  # Leaving each broker.
    region_gbit: float  # Leaving all brokers.
    nats_mbit: float  # Into and out of the NATS cluster.
    assets_gbit: float  # Of joins, from brokers or a CDN.


def watched_streams(crowd, brokers):
    """Different streams among the viewers of one broker, where each viewer picks at random."""
    picks = crowd.viewers / brokers * crowd.watched
    return crowd.streams * (1 - (1 - 1 / crowd.streams) ** picks) if crowd.streams > 1 else min(1.0, picks)


def signs(crowd, brokers):
    """Signs of life that each broker hears in a second: of those with a stream's sender all, of the others some."""
    return min(brokers, SPEAKERS + crowd.streams)


def core_of(crowd, brokers, costs):
    deliveries = crowd.viewers / brokers * crowd.watched * crowd.key_rate * crowd.k
    followed = watched_streams(crowd, brokers)
    poses = followed * crowd.key_rate * ((crowd.k - 1) * costs.pose_us + costs.hop_us)
    poses += signs(crowd, brokers) * costs.hop_us
    return costs.idle_core + (deliveries * costs.cpu_s_per_million + poses) / 1e6


def plan(crowd, costs):
    brokers = math.ceil(crowd.viewers / costs.viewers_per_broker)
    while core_of(crowd, brokers, costs) > costs.load:
        brokers = max(brokers + 1, math.ceil(brokers * 1.02))
    per_viewer = crowd.watched * crowd.key_rate * (crowd.key_bytes + (crowd.k - 1) * crowd.pose_bytes) * 8
    followed = watched_streams(crowd, brokers)
    nats = 8 * (crowd.key_rate * crowd.key_bytes * (crowd.streams + brokers * followed) + brokers * signs(crowd, brokers) * SIGN_BYTES)
    return Plan(brokers, core_of(crowd, brokers, costs), followed, crowd.viewers / brokers * per_viewer / 1e6,
                crowd.viewers * per_viewer / 1e9, nats / 1e6, crowd.joins_per_s * crowd.asset_bytes * 8 / 1e9)


def simulate(crowd, brokers, costs, seed=1):
    """Core shares of all brokers with viewers placed at random, each watching random streams, a pose at a time."""
    chance = random.Random(seed)
    load = [costs.idle_core] * brokers
    streams = [set() for _ in range(brokers)]
    for _ in range(crowd.viewers):
        at = chance.randrange(brokers)
        for _ in range(crowd.watched):
            streams[at].add(chance.randrange(crowd.streams))
        load[at] += crowd.watched * crowd.key_rate * crowd.k * costs.cpu_s_per_million / 1e6
    for at in range(brokers):
        load[at] += signs(crowd, brokers) * costs.hop_us / 1e6
        load[at] += len(streams[at]) * crowd.key_rate * ((crowd.k - 1) * costs.pose_us + costs.hop_us) / 1e6
    return load


def number(value):
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--viewers", type=int, nargs="+", default=[10_000, 1_000_000, 100_000_000])
    parser.add_argument("--streams", type=int, default=10)
    parser.add_argument("--joins-per-s", type=float, default=None, help="of the whole crowd; default: a hundredth of it a minute")
    parser.add_argument("--check", action="store_true", help="compare the model with the simulation, up to a million viewers")
    for field in dataclasses.fields(Costs):
        parser.add_argument("--" + field.name.replace("_", "-"), type=type(field.default), default=field.default)
    options = parser.parse_args()
    costs = Costs(**{field.name: getattr(options, field.name) for field in dataclasses.fields(Costs)})
    print(f"{'viewers':>12} {'brokers':>8} {'core':>6} {'streams each':>13} {'Mbit/s each':>12} {'Gbit/s in all':>14} {'NATS Mbit/s':>12} {'assets Gbit/s':>14}")
    for viewers in options.viewers:
        joins = options.joins_per_s if options.joins_per_s is not None else viewers / 6000
        crowd = Crowd(viewers, options.streams, joins_per_s=joins)
        p = plan(crowd, costs)
        print(f"{viewers:12,} {p.brokers:8,} {p.core:6.2f} {number(p.followed):>13} {number(p.broker_mbit):>12} {number(p.region_gbit):>14} "
              f"{number(p.nats_mbit):>12} {number(p.assets_gbit):>14}")
        if options.check and viewers <= 1_000_000:
            load = simulate(crowd, p.brokers, costs)
            print(f"{'':12} simulated: core {sum(load) / len(load):.2f} in the mean, {max(load):.2f} at the busiest broker")


if __name__ == "__main__":
    main()
