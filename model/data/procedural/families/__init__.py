"""One file for each few related families; the table of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from model.data.procedural.families import (
    decor,
    devices,
    furniture,
    handheld,
    household,
    kitchen,
    machines,
    seating,
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
    "Cart": furniture.cart,
    "Chair": seating.chair,
    "Clock": decor.clock,
    "CoffeeMachine": machines.coffee_machine,
    "Dishwasher": washing.dishwasher,
    "Dispenser": vessels.dispenser,
    "Display": devices.display,
    "Door": household.door,
    "Eyeglasses": handheld.eyeglasses,
    "Fan": decor.fan,
    "Faucet": washing.faucet,
    "FoldingChair": seating.folding_chair,
    "Globe": decor.globe,
    "Kettle": vessels.kettle,
    "Keyboard": devices.keyboard,
    "KitchenPot": vessels.kitchen_pot,
    "Knife": handheld.knife,
    "Lamp": decor.lamp,
    "Laptop": devices.laptop,
    "Lighter": handheld.lighter,
    "Microwave": kitchen.microwave,
    "Mouse": devices.mouse,
    "Oven": kitchen.oven,
    "Pen": handheld.pen,
    "Phone": devices.phone,
    "Pliers": handheld.pliers,
    "Printer": machines.printer,
    "Refrigerator": kitchen.refrigerator,
    "Remote": devices.remote,
    "Safe": household.safe,
    "Scissors": handheld.scissors,
    "Stapler": handheld.stapler,
    "StorageFurniture": furniture.storage_furniture,
    "Suitcase": household.suitcase,
    "Switch": devices.switch,
    "Table": furniture.table,
    "Toaster": machines.toaster,
    "Toilet": washing.toilet,
    "TrashCan": household.trash_can,
    "USB": handheld.usb,
    "WashingMachine": washing.washing_machine,
    "Window": household.window,
}
"""PartNet-Mobility's 46 categories by name -> what makes one from a generator."""

HELD_OUT = ("Display", "Suitcase", "Pliers", "Kettle", "Oven")
"""Families that shipped weights never saw, as in ArtiWorld's experiments."""
