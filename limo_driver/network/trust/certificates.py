"""A private certificate authority and the certificates that it issues; needs limo[secure]."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

if TYPE_CHECKING:
    from typing import Self

    from limo_driver.network.trust.roles import Host

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
