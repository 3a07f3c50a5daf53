"""The server's side of a kernel's messages, which leave for the browser at once. Only a server imports this."""

from asyncio import Future

from jupyter_server.services.kernels.connection.channels import ZMQChannelsWebsocketConnection


class PromptChannels(ZMQChannelsWebsocketConnection):
    """Jupyter's websocket connection of a kernel, without waiting for the browser's acknowledgements.

    By default, TCP keeps a message back until the one before it has been acknowledged (Nagle's algorithm), and Linux
    waits 40 ms with that unless there is something to answer: the pictures of a move would wait for the message that
    the kernel is busy. Jupyter Server 2.21 leaves it so.
    """

    def connect(self) -> Future[None] | None:
        """See `BaseKernelWebsocketConnection.connect`."""
        self.websocket_handler.set_nodelay(True)
        return super().connect()
