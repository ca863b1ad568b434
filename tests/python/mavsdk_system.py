"""One system by MAVSDK-Python 3 or 4, whichever is installed.

Plugins, calls and types have the same names in both; only the ways to reach them differ, and those are here.
"""

import asyncio
import gc
import importlib
import importlib.util
import inspect
import json
import socket

import plan

VERSION = 4 if importlib.util.find_spec("mavsdk.asyncio") else 3


def types(plugin):
    """The module with a plugin's types."""
    return importlib.import_module(f"mavsdk.plugins.{plugin}" if VERSION == 4 else f"mavsdk.{plugin}")


class KeptCallbacks(dict):
    """Subscriptions of a plugin of version 4 whose callbacks outlive them.

    MAVSDK 4.1 may still call one that it had queued when it was unsubscribed; by then its memory is another's, and the client
    crashes. Streams that are left as soon as a value has come make it happen.
    """

    ended = []

    def pop(self, handle, default=None):
        entry = super().pop(handle, default)
        KeptCallbacks.ended.append(entry)
        return entry


class MavsdkSystem:
    """The plugins of the vehicle that a script of instance `instance` hears."""

    def __init__(self, instance):
        self.url = f"udpin://127.0.0.1:{14540 + instance}"
        self._plugins, self._tasks = {}, []
        self._acks, self._drone = [], None

    async def connect(self, limit_s=15.0):
        if VERSION == 4:
            from mavsdk.asyncio import ComponentType, Configuration, Mavsdk

            self._mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            await self._mavsdk.add_any_connection(self.url)
            self._system = await self._mavsdk.first_autopilot(timeout_s=limit_s)
            plan.expect(self._system, "no autopilot found")
            self.system_id = await self._system.get_system_id()
            return
        from mavsdk import System

        # A port for the server that version 3 starts: its default would clash with a second script.
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self._drone = System(port=port)
        await self._drone.connect(system_address=self.url)

        async def connected():
            async for state in self._drone.core.connection_state():
                if state.is_connected:
                    return

        await asyncio.wait_for(connected(), limit_s)
        self.keep("mavlink_direct.message", self._heartbeat, "HEARTBEAT")
        self.keep("mavlink_direct.message", self._ack, "COMMAND_ACK")

    def plugin(self, name):
        if name not in self._plugins:
            if VERSION == 4:
                module = importlib.import_module(f"mavsdk.asyncio.plugins.{name}")
                title = "".join(part.title() for part in name.split("_"))
                self._plugins[name] = getattr(module, f"{title}Async")(self._system)
                self._plugins[name]._plugin._subscriptions = KeptCallbacks()
            else:
                self._plugins[name] = getattr(self._drone, name)
        return self._plugins[name]

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        return self.plugin(name)

    def function(self, name):
        """`plugin.call` or `plugin.stream`, without the prefix that version 4 gives a stream."""
        plugin, call = name.split(".")
        plugin = self.plugin(plugin)
        return getattr(plugin, f"subscribe_{call}", None) or getattr(plugin, call)

    def calls(self, plugin):
        """The names of a plugin's calls and streams, without that prefix."""
        names = {n for n, f in inspect.getmembers(type(self.plugin(plugin)), inspect.isfunction) if not n.startswith("_")}
        return sorted({n.removeprefix("subscribe_") for n in names} - {"destroy"})

    def streams(self, plugin):
        """Those of them that are streams, which in neither version set or get anything."""
        return [name for name in self.calls(plugin) if not name.startswith(("set_", "get_"))]

    def keep(self, name, take, *args):
        """Gives every value of the stream `plugin.name` to `take`, until the end."""

        async def follow():
            async for value in self.function(name)(*args):
                take(value)

        self._tasks.append(asyncio.create_task(follow()))

    def _heartbeat(self, message):
        if message.component_id == 1:
            self.system_id = message.system_id

    def _ack(self, message):
        self._acks.append((message.component_id, json.loads(message.fields_json)))

    async def command(self, component, name, fields):
        """Sends COMMAND_LONG or COMMAND_INT to a component; it has to accept."""
        fields = {"target_system": self.system_id, "target_component": component, **fields}
        message = types("mavlink_direct").MavlinkMessage(name, 0, 0, self.system_id, component, json.dumps(fields))
        result = await (self._confirmed if VERSION == 4 else self._repeated)(message, component, fields["command"])
        plan.expect(result is not None, f"{name} {fields['command']} was not acknowledged")
        plan.expect(result == 0, f"{name} {fields['command']} got result {result}")

    async def _confirmed(self, message, _component, _command):
        ack = await self.plugin("mavlink_direct").send_command(message)
        return json.loads(ack.fields_json)["result"]

    async def _repeated(self, message, component, command):
        """Version 3 sends any message, but waits for no acknowledgement: repeat and look for it."""
        for _ in range(4):
            self._acks.clear()
            await self.plugin("mavlink_direct").send_message(message)
            for _ in range(50):
                for source, ack in self._acks:
                    if (source, ack["command"]) == (component, command):
                        return ack["result"]
                await asyncio.sleep(0.01)
        return None

    def end(self):
        """Ends the server that version 3 starts, for a script that ends at once: it would keep the port."""
        if self._drone is not None:
            self._drone.__del__()

    async def close(self):
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()
        self._plugins.clear()
        if VERSION == 4:
            self._mavsdk.destroy()
        else:
            # The server that version 3 started ends with the last reference to its System, and without that the script
            # does not end.
            self._drone = None
            gc.collect()
