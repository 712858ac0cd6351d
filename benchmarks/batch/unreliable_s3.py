"""moto's S3 on the loopback interface; every n-th request fails like a request to an overloaded store."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

SLOW_DOWN = (
    b'<?xml version="1.0" encoding="UTF-8"?><Error><Code>SlowDown</Code>'
    b"<Message>Please reduce your request rate.</Message></Error>"
)


@dataclass
class UnreliableS3:
    """The server's address and the number of failed requests."""

    every: int
    url: str = ""
    failures: int = 0
    requests: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    def wrap(self, application: Callable[..., Iterable[bytes]]) -> Callable[..., Iterable[bytes]]:
        """A WSGI application that answers every n-th request with status 503 and passes on the others."""

        def answer(environment: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
            if next(self.requests) % self.every == 0:
                self.failures += 1
                environment["wsgi.input"].read(int(environment.get("CONTENT_LENGTH") or 0))
                start("503 Slow Down", [("Content-Type", "application/xml"), ("Connection", "close")])
                return [SLOW_DOWN]
            return application(environment, start)

        return answer


@contextlib.contextmanager
def unreliable_s3(every: int = 19) -> Iterator[UnreliableS3]:
    """The server; meanwhile environment variables direct new processes to it."""
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    store = UnreliableS3(every)
    application = store.wrap(DomainDispatcherApplication(create_backend_app))
    server = make_server("127.0.0.1", 0, application, threaded=True)
    store.url = f"http://127.0.0.1:{server.server_port}"
    variables = {
        "AWS_ENDPOINT_URL": store.url,
        "AWS_ACCESS_KEY_ID": "loopback",
        "AWS_SECRET_ACCESS_KEY": "loopback",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    previous = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    try:
        yield store
    finally:
        server.shutdown()
        serving.join()
        for name, value in previous.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
