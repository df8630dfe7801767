"""One file for each few related families; the table of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from model.data.procedural.families import (
    bathroom,
    cooling,
    decor,
    devices,
    electronics,
    household,
    kitchen,
    machines,
    openings,
    pocket,
    seating,
    storage,
    tables,
    tools,
    vessels,
    washing,
)
from model.data.procedural.grammar import ProceduralObject

Family = Callable[[np.random.Generator], ProceduralObject]

FAMILIES: Mapping[str, Family] = {
    "Bottle": vessels.bottle,
    "Box": household.box,
    "Bucket": vessels.bucket,
    "Camera": machines.camera,
    "Cart": tables.cart,
    "Chair": seating.chair,
    "Clock": decor.clock,
    "CoffeeMachine": machines.coffee_machine,
    "Dishwasher": washing.dishwasher,
    "Dispenser": vessels.dispenser,
    "Display": devices.display,
    "Door": openings.door,
    "Eyeglasses": pocket.eyeglasses,
    "Fan": decor.fan,
    "Faucet": bathroom.faucet,
    "FoldingChair": seating.folding_chair,
    "Globe": decor.globe,
    "Kettle": vessels.kettle,
    "Keyboard": devices.keyboard,
    "KitchenPot": vessels.kitchen_pot,
    "Knife": tools.knife,
    "Lamp": decor.lamp,
    "Laptop": electronics.laptop,
    "Lighter": pocket.lighter,
    "Microwave": kitchen.microwave,
    "Mouse": devices.mouse,
    "Oven": kitchen.oven,
    "Pen": pocket.pen,
    "Phone": devices.phone,
    "Pliers": tools.pliers,
    "Printer": machines.printer,
    "Refrigerator": cooling.refrigerator,
    "Remote": devices.remote,
    "Safe": household.safe,
    "Scissors": tools.scissors,
    "Stapler": tools.stapler,
    "StorageFurniture": storage.storage_furniture,
    "Suitcase": household.suitcase,
    "Switch": devices.switch,
    "Table": tables.table,
    "Toaster": machines.toaster,
    "Toilet": bathroom.toilet,
    "TrashCan": household.trash_can,
    "USB": pocket.usb,
    "WashingMachine": washing.washing_machine,
    "Window": openings.window,
}
"""PartNet-Mobility's 46 categories by name -> what makes one from a generator."""

HELD_OUT = ("Display", "Suitcase", "Pliers", "Kettle", "Oven")
"""Families that shipped weights never saw, as in ArtiWorld's experiments."""
