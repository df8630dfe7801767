"""One file for each few related families; the table of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from model.datasets.procedural.families import (
    decor,
    devices,
    electronics,
    household,
    kitchen,
    seating,
    storage,
    tools,
    vessels,
)
from model.datasets.procedural.grammar import ProceduralObject

Family = Callable[[np.random.Generator], ProceduralObject]

FAMILIES: Mapping[str, Family] = {
    "Bottle": vessels.bottle,
    "Box": household.box,
    "Bucket": vessels.bucket,
    "Camera": devices.camera,
    "Cart": household.cart,
    "Chair": seating.chair,
    "Clock": decor.clock,
    "CoffeeMachine": devices.coffee_machine,
    "Dishwasher": kitchen.dishwasher,
    "Dispenser": vessels.dispenser,
    "Display": devices.display,
    "Door": household.door,
    "Eyeglasses": tools.eyeglasses,
    "Fan": decor.fan,
    "Faucet": household.faucet,
    "FoldingChair": seating.folding_chair,
    "Globe": decor.globe,
    "Kettle": vessels.kettle,
    "Keyboard": devices.keyboard,
    "KitchenPot": vessels.kitchen_pot,
    "Knife": tools.knife,
    "Lamp": decor.lamp,
    "Laptop": electronics.laptop,
    "Lighter": tools.lighter,
    "Microwave": kitchen.microwave,
    "Mouse": devices.mouse,
    "Oven": kitchen.oven,
    "Pen": tools.pen,
    "Phone": devices.phone,
    "Pliers": tools.pliers,
    "Printer": devices.printer,
    "Refrigerator": kitchen.refrigerator,
    "Remote": devices.remote,
    "Safe": household.safe,
    "Scissors": tools.scissors,
    "Stapler": tools.stapler,
    "StorageFurniture": storage.storage_furniture,
    "Suitcase": household.suitcase,
    "Switch": devices.switch,
    "Table": household.table,
    "Toaster": devices.toaster,
    "Toilet": household.toilet,
    "TrashCan": household.trash_can,
    "USB": tools.usb,
    "WashingMachine": kitchen.washing_machine,
    "Window": household.window,
}
"""PartNet-Mobility's 46 categories by name -> what makes one from a generator."""

HELD_OUT = ("Display", "Suitcase", "Pliers", "Kettle", "Oven")
"""Families that shipped weights never saw, as in ArtiWorld's experiments."""
