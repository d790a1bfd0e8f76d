"""Access control on the network: roles, certificates, and Zenoh's configuration for each role."""

from limo_driver.network.trust.folder import TrustFolder, write_trust
from limo_driver.network.trust.roles import ROLES, Host, Role

__all__ = ["ROLES", "Host", "Role", "TrustFolder", "write_trust"]
