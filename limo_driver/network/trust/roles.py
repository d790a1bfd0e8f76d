"""Who may do what on a network: roles, their access lists, and the hosts that they are for.

The roles on the network, and the access control lists that follow from them.

Every session checks what comes in from the sessions that it is linked to, by the common name of
their certificate. What goes out is its own affair: a list that a session keeps about itself would
protect nobody from it.

Chunks that begin with `@` are matched by no wildcard, so what the caches of events and status need
is listed beside their keys.

A private certificate authority and the certificates that it issues; needs limo[secure].
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final, Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from limo_driver.errors import ConfigError

_CACHE: Final = "/@adv/**"  # what zenoh.ext adds to the keys of its caches
_INDEX: Final = "limo/*/model/index"
_SEEN: Final = "limo/*/seen/*"  # which drivers and services somebody sees
_EVERYTHING: Final = ("limo/**", f"limo/**{_CACHE}")
_ALL_MESSAGES: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
_HOST: Final = re.compile(r"(?P<name>[A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\])(:(?P<port>[0-9]{1,5}))?")
_PORTS: Final = range(1, 65536)


@dataclass(frozen=True)
class Role:
    """Role of a session: what it may send. Any role may receive everything under `limo/`."""

    name: str  # common name of its certificate, and its user name
    purpose: str
    publishes: tuple[str, ...] = ()  # key expressions
    keeps: tuple[str, ...] = ()  # published with a cache for those who come late
    announces: tuple[str, ...] = ()  # liveliness tokens
    answers: tuple[str, ...] = ()  # queries
    asks: tuple[str, ...] = (_INDEX,)
    links_to: tuple[str, ...] = ()  # roles that it reaches; the others reach it


ROLES: Final = {
    role.name: role
    for role in (
        Role(
            "driver",
            "drives the arm and publishes its joint states",
            publishes=("limo/*/state/**",),
            announces=("limo/*/alive/driver/*",),
            answers=(_SEEN,),
            asks=(_INDEX, _SEEN),
        ),
        Role(
            "service",
            "publishes torque estimates and events, and answers queries about models",
            publishes=("limo/*/torque/**", "limo/*/contact"),
            keeps=("limo/*/event", "limo/*/status/service"),
            announces=("limo/*/alive/service/*",),
            answers=("limo/*/model/**", _SEEN),
            asks=(_INDEX, _SEEN),
            links_to=("driver",),
        ),
        Role(
            "operator",
            "sends commands, and loads, promotes and rolls back models",
            publishes=("limo/*/command/**",),
            answers=(_SEEN,),
            asks=("limo/*/model/**",),
            links_to=("driver", "service"),
        ),
        Role("viewer", "only reads", answers=(_SEEN,), links_to=("driver", "service")),
    )
}


def access_control(role: Role) -> dict[str, Any]:
    """Return Zenoh's `access_control` for sessions of a role."""
    others = [
        other
        for other in ROLES.values()
        if other.name in role.links_to or role.name in other.links_to
    ]
    rules = [_rule("ours", _ALL_MESSAGES, _EVERYTHING, "egress"), _hears()]
    for other in others:
        rules += _sends(other)
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [_subject(role, other) for other in others],
        "policies": [
            {
                "subjects": [other.name],
                "rules": ["ours", "hears", *(rule["id"] for rule in _sends(other))],
            }
            for other in others
        ],
    }


def _subject(role: Role, other: Role) -> dict[str, Any]:
    """Return how another role is known: only who opens a link gives a user name."""
    known: dict[str, Any] = {"id": other.name, "cert_common_names": [other.name]}
    if role.name in other.links_to:
        known["usernames"] = [other.name]
    return known


def _hears() -> dict[str, Any]:
    messages = ("declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
    return _rule("hears", messages, _EVERYTHING)


def _sends(role: Role) -> list[dict[str, Any]]:
    """Return the rules of what may come in from a role."""
    caches = tuple(key + _CACHE for key in role.keeps)
    kept = tuple(key + _CACHE for other in ROLES.values() for key in other.keeps)
    permitted = {
        "publishes": (("put", "delete"), role.publishes + role.keeps + caches),
        "announces": (("liveliness_token",), role.announces + caches),
        "answers": (("declare_queryable", "reply"), role.answers + role.keeps + caches),
        "asks": (("query",), role.asks + kept),
    }
    return [
        _rule(f"{role.name} {verb}", messages, keys)
        for verb, (messages, keys) in permitted.items()
        if keys
    ]


def _rule(
    name: str, messages: tuple[str, ...], keys: tuple[str, ...], flow: str = "ingress"
) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }


@dataclass(frozen=True)
class Host:
    """A host name or address, and a port."""

    name: str
    port: int

    @classmethod
    def parse(cls, text: str, port: int) -> Self:
        """Return `HOST` or `HOST:PORT`, an IPv6 address in brackets.

        Args:
            text: As written.
            port: Where none is written.

        Raises:
            ConfigError: It is neither.
        """
        match = _HOST.fullmatch(text)
        if match is None or int(match["port"] or port) not in _PORTS:
            raise ConfigError(f"the host is {text!r}, expected HOST or HOST:PORT")
        return cls(match["name"].strip("[]"), int(match["port"] or port))

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The name as an IP address, if it is one."""
        try:
            return ipaddress.ip_address(self.name)
        except ValueError:
            return None

    @property
    def endpoint(self) -> str:
        """Zenoh's endpoint."""
        name = f"[{self.name}]" if ":" in self.name else self.name
        return f"tls/{name}:{self.port}"


_SKEW: Final = timedelta(hours=1)  # that the clock of a robot may be behind
_AUTHORITY: Final = "limo"


@dataclass(frozen=True)
class Issued:
    """A certificate and its private key, PEM."""

    certificate: bytes
    key: bytes


class Authority:
    """Issues certificates that every role trusts, and nobody else does.

    Args:
        key: Its private key.
        certificate: Its own certificate.
        days: For which certificates are valid.
    """

    def __init__(
        self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate, days: int
    ) -> None:
        self._key, self._certificate, self._days = key, certificate, days

    @classmethod
    def new(cls, days: int) -> Self:
        """Make an authority with a key of its own."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(_AUTHORITY)
        builder = (
            _builder(name, name, key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
        )
        return cls(key, builder.sign(key, hashes.SHA256()), days)

    @property
    def issued(self) -> Issued:
        """Its own certificate and key."""
        return _as_pem(self._certificate, self._key)

    def issue(self, name: str, host: Host | None) -> Issued:
        """Issue a certificate.

        Args:
            name: Common name, which access is controlled by.
            host: Where it is reached, for those who are; others only prove who they are.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = _builder(
            _name(name), self._certificate.subject, key.public_key(), self._days
        ).add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        if host is not None:
            purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
            address = host.address
            at = x509.DNSName(host.name) if address is None else x509.IPAddress(address)
            builder = builder.add_extension(x509.SubjectAlternativeName([at]), critical=False)
        builder = builder.add_extension(_usage(signs=False), critical=True).add_extension(
            x509.ExtendedKeyUsage(purposes), critical=False
        )
        return _as_pem(builder.sign(self._key, hashes.SHA256()), key)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _as_pem(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Issued:
    return Issued(
        certificate.public_bytes(serialization.Encoding.PEM),
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )
