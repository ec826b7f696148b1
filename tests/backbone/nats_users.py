# SPDX-License-Identifier: MIT
"""Operator, account and user of a NATS server with signed users: what its tool nsc makes, for tests, by openssl.

Keys are written as NATS does (package nkeys: a kind, the key, a CRC, in base 32); a .creds file holds a user's JWT and seed.
"""
import base64
import binascii
import json
import pathlib
import subprocess
import time

OPERATOR, ACCOUNT, USER = 14 << 3, 0, 20 << 3
SEED = 18 << 3
UNLIMITED = dict.fromkeys(("subs", "data", "payload", "imports", "exports", "conn", "leaf"), -1) | {"wildcards": True}
JET_STREAM = dict.fromkeys(("mem_storage", "disk_storage", "streams", "consumer"), -1)


def in_base_32(data):
    return base64.b32encode(data + binascii.crc_hqx(data, 0).to_bytes(2, "little")).decode().rstrip("=")


def in_base_64(data):
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


class Key:
    def __init__(self, kind, folder):
        openssl = lambda *words, **more: subprocess.run(["openssl", *words], check=True, capture_output=True, **more).stdout
        self.file = pathlib.Path(folder, f"nkey-{kind}-{time.monotonic_ns()}.pem")
        openssl("genpkey", "-algorithm", "ed25519", "-out", self.file)
        private = openssl("pkey", "-in", self.file, "-outform", "DER")[-32:]
        self.public = in_base_32(bytes([kind]) + openssl("pkey", "-in", self.file, "-pubout", "-outform", "DER")[-32:])
        self.seed = in_base_32(bytes([SEED | kind >> 5, (kind & 31) << 3]) + private)

    def signs(self, subject, claims):
        """The JWT with which this key vouches for `subject`."""
        body = {"iat": int(time.time()), "iss": self.public, "name": "test", "sub": subject.public, "nats": {**claims, "version": 2}}
        body["jti"] = in_base_32(json.dumps(body).encode())[:52]
        text = ".".join(in_base_64(json.dumps(part).encode()) for part in ({"typ": "JWT", "alg": "ed25519-nkey"}, body))
        unsigned = self.file.with_suffix(".jwt")
        unsigned.write_text(text)
        signed = subprocess.run(["openssl", "pkeyutl", "-sign", "-rawin", "-inkey", self.file, "-in", unsigned], check=True, capture_output=True)
        return f"{text}.{in_base_64(signed.stdout)}"


def make(folder):
    """A user's credentials, and the lines for the configuration of a server that takes them."""
    operator, system, account, user = Key(OPERATOR, folder), Key(ACCOUNT, folder), Key(ACCOUNT, folder), Key(USER, folder)
    account_jwt = operator.signs(account, {"type": "account", "limits": UNLIMITED | JET_STREAM})
    system_jwt = operator.signs(system, {"type": "account", "limits": UNLIMITED})
    user_jwt = account.signs(user, {"type": "user", "subs": -1, "data": -1, "payload": -1})
    credentials = (f"-----BEGIN NATS USER JWT-----\n{user_jwt}\n------END NATS USER JWT------\n\n"
                   f"-----BEGIN USER NKEY SEED-----\n{user.seed}\n------END USER NKEY SEED------\n")
    server = (f"operator: {operator.signs(operator, {'type': 'operator'})}\nsystem_account: {system.public}\nresolver: MEMORY\n"
              f"resolver_preload: {{ {account.public}: {account_jwt}, {system.public}: {system_jwt} }}\n")
    return credentials, server
